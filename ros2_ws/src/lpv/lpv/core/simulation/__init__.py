"""The simulated arm with its faulty sensors, and the closed loop."""
