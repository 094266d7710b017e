"""Recorded runs as NumPy arrays."""
