"""Arm model, observer, diagnosis and tracking of a two-link arm; free of ROS."""
