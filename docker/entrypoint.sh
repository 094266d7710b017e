#!/bin/bash
# Every command of the container runs with ROS 2 and this software on the PATH.
source /opt/ros/kilted/setup.bash
source /opt/lpv-arm-fdi/tools/env.sh
exec "$@"
