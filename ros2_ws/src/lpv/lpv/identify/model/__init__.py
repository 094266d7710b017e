"""Regressors and constraints of rigid bodies and friction."""
