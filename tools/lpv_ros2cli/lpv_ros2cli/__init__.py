"""The everyday part of the ``ros2`` command, for machines without ros2cli."""
