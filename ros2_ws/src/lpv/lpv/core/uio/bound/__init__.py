"""Guaranteed bounds on the error of the fault estimates."""
