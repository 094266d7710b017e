"""From motion and torques to parameters."""
