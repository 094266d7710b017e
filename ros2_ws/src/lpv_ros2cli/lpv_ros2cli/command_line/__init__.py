"""Parsing, completion and interruption of a command line."""
