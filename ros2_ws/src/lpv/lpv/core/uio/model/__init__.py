"""The arm: parameters, coordinates, dynamics, kinematics, polytopic and state-space models."""
