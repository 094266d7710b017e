"""Tracking controller of a two-link arm."""
