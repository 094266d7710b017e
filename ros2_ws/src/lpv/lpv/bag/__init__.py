"""Recording and reading of bags."""
