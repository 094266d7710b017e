"""Interface types, and messages as text."""
