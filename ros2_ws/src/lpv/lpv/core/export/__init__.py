"""The arm in the formats of other software."""
