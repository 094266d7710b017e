"""Decisions on faults: alarm, kind, magnitude."""
