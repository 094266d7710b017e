"""The lpv command: design, demo, import, replay, compare, report."""
