"""Sensors of serial arms: estimates, hypotheses, decisions."""
