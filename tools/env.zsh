# To be sourced by zsh: the built workspace, on top of a sourced ROS 2 or of the wheels.
_lpv_root=${${(%):-%x}:A:h:h}
_lpv_venv=${VENV:-$_lpv_root/.venv}
if [[ -n "${ROS_DISTRO:-}" && -f "$_lpv_venv/local_setup.zsh" ]]; then
  source "$_lpv_venv/local_setup.zsh"
fi
export PATH="$_lpv_venv/bin:$PATH"
# Tab completion; a real ros2 has its own.
if [[ -o interactive && -x "$_lpv_venv/bin/register-python-argcomplete" ]]; then
  (( $+functions[compdef] )) || { autoload -Uz compinit && compinit -i }
  eval "$("$_lpv_venv/bin/register-python-argcomplete" lpv)"
  [[ ! -x "$_lpv_venv/bin/ros2" ]] || eval "$("$_lpv_venv/bin/register-python-argcomplete" ros2)"
fi
unset _lpv_root _lpv_venv
