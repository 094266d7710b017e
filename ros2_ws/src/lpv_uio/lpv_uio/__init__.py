"""Unknown-input observer and sensor-fault diagnosis of a two-link arm."""
