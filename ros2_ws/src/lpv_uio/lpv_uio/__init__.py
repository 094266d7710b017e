"""Unknown-input observer and sensor-fault diagnosis of a robot arm."""
