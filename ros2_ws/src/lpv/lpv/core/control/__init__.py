"""Paths, references and the tracking controller."""
