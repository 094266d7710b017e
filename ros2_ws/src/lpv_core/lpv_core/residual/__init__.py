"""Residuals of the sensors and the tests on them."""
