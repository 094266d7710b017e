"""What happened in a run: alarms as episodes, phases, timeline."""
