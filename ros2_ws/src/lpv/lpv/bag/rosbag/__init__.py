"""rosbag2 bags and their messages."""
