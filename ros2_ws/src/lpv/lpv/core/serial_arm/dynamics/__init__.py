"""Compiled rigid-body dynamics and kinematics of serial arms."""
