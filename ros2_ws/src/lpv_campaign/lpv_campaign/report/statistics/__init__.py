"""Statistics that the sections share."""
