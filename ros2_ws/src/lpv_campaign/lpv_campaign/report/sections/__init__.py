"""Sections of the report, as plain values for its template."""
