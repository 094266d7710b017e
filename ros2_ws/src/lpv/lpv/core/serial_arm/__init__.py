"""Serial arms of n revolute joints: description, kinematics, dynamics."""
