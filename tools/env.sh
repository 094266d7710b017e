# To be sourced by bash: the built workspace, on top of a sourced ROS 2 or of the wheels.
_lpv_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
_lpv_venv=${VENV:-$_lpv_root/.venv}
if [ -n "${ROS_DISTRO:-}" ] && [ -f "$_lpv_venv/local_setup.bash" ]; then
  source "$_lpv_venv/local_setup.bash"
fi
export PATH="$_lpv_venv/bin:$PATH"
# Tab completion; a real ros2 has its own.
if [[ $- == *i* ]] && [ -x "$_lpv_venv/bin/register-python-argcomplete" ]; then
  eval "$("$_lpv_venv/bin/register-python-argcomplete" lpv)"
  [ ! -x "$_lpv_venv/bin/ros2" ] || eval "$("$_lpv_venv/bin/register-python-argcomplete" ros2)"
fi
unset _lpv_root _lpv_venv
