"""Fixtures of the serial arm's tests: random chains and the same in Pinocchio."""

from hypothesis import settings

# Compilation takes seconds in the first example; the same examples are drawn in every run.
settings.register_profile('lpv', deadline=None, derandomize=True, database=None, max_examples=60)
settings.load_profile('lpv')
