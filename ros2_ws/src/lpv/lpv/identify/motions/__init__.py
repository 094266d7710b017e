"""Motions that identify an arm."""
