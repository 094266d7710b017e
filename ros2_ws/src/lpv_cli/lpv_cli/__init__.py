"""The lpv command: design, demo, import, replay, report."""
