"""Gains and the conditions that prove them."""
