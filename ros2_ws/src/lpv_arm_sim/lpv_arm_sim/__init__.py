"""Simulated two-link arm with faulty joint sensors."""
