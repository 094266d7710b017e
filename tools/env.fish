# To be sourced by fish: the built workspace of the wheels. colcon writes no set-up for fish: on top
# of a sourced ROS 2, start fish from a bash that has sourced tools/env.sh.
set -l _lpv_root (realpath (dirname (status filename))/..)
set -l _lpv_venv $_lpv_root/.venv
set -q VENV; and set _lpv_venv $VENV
set -gx PATH $_lpv_venv/bin $PATH
# Tab completion; a real ros2 has its own.
if status is-interactive; and test -x $_lpv_venv/bin/register-python-argcomplete
    $_lpv_venv/bin/register-python-argcomplete --shell fish lpv | source
    test -x $_lpv_venv/bin/ros2
    and $_lpv_venv/bin/register-python-argcomplete --shell fish ros2 | source
end
