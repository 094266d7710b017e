#!/usr/bin/env bash
# Sets everything up in a virtual environment; does only what is not done already.
#
#   tools/setup.sh [extras|test|bench|docs]    also installs what single commands, tests, benchmarks
#                                              or the documentation need
#
# PYTHON   interpreter to use (default: python3), 3.10 to 3.13
# VENV     environment to make (default: .venv in this folder's parent)
#
# Where a ROS 2 is sourced, that one is used; otherwise ROS 2 comes from wheels.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=${VENV:-$root/.venv}
build=$root/.build
python=${PYTHON:-python3}
state=$venv/.lpv
unset PYTHONDONTWRITEBYTECODE

fail() { echo "setup: $*" >&2; exit 1; }
say() { echo "setup: $*"; }

choose_source() {
  source=wheels
  if [ -n "${ROS_DISTRO:-}" ]; then
    # Wheels beside a sourced ROS 2 would mix two builds of the same libraries.
    "$python" -c 'import rclpy' ||
      fail "ROS 2 $ROS_DISTRO is sourced, but $python cannot import its rclpy (see above): set" \
        "PYTHON to the interpreter that it was built for, or start from a shell without ROS 2"
    source=sourced
  elif [ "$(uname -s)-$(uname -m)" != Linux-x86_64 ]; then
    fail "there are ROS 2 wheels for Linux x86_64 only; source a ROS 2 (Jazzy or later) first"
  fi
}

# CMake, Ninja and the generators of messages split such paths.
check_paths() {
  local path
  for path in "$root" "$venv"; do
    case $path in
      *[[:space:]]*) fail "'$path' contains a space, which ROS 2's build tools cannot handle: move" \
        "the checkout (or set VENV) to a path without spaces" ;;
    esac
  done
}

check_machine() {
  command -v "$python" >/dev/null || fail "$python is missing: apt-get install python3 python3-venv"
  "$python" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' ||
    fail "$("$python" --version) does not do: Python 3.10 to 3.13 is needed (set PYTHON)"
  "$python" -c 'import venv, ensurepip' 2>/dev/null ||
    fail "Python's venv is missing: apt-get install python3-venv"
  command -v g++ >/dev/null || fail "a C++ compiler is missing: apt-get install g++"
  "$python" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")))' ||
    fail "Python's headers are missing: apt-get install python3-dev"
}

hash_of() { sha256sum "$@" | sha256sum | cut -c1-64; }

# Every program reads a thousand modules when it starts: they are kept as byte code, also where
# PYTHONDONTWRITEBYTECODE is set.  Compiling all that is installed would take longer than the demo.
keep_byte_code() (
  set +u
  source "$root/tools/env.sh"
  python -c 'import lpv.cli.commands.demo, lpv.report.run, lpv_design.design_flow
import lpv_arm_sim.node, lpv_node.recorder.node, lpv_tracker.node, lpv_uio.node'
)

source_hash() {
  (cd "$root" && find design ros2_ws/src tools/lpv_ros2cli -type f -not -path '*/__pycache__/*' \
    -not -path '*.egg-info/*' -print0 | sort -z | xargs -0 sha256sum | sha256sum | cut -c1-64)
}

done_already() { [ -f "$state/$1" ] && [ "$(cat "$state/$1")" = "$2" ]; }
mark_done() { mkdir -p "$state"; echo "$2" > "$state/$1"; }

make_venv() {
  local id
  id="$source $("$python" -c 'import sys; print(sys.base_prefix, sys.version)' | tr '\n' ' ')"
  done_already venv "$id" && return 0
  say "making the environment $venv ($source ROS 2)"
  rm -rf "$venv" "$build"
  if [ "$source" = sourced ]; then
    "$python" -m venv --system-site-packages "$venv"
  else
    "$python" -m venv "$venv"
  fi
  mark_done venv "$id"
}

install_requirements() {
  local name=$1 id
  shift
  id=$(hash_of "$@")
  done_already "$name" "$id" && return 0
  say "installing $name requirements"
  install_packages "$name" "${@/#/-r}"
  link_duplicates
  mark_done "$name" "$id"
}

install_packages() {
  local name=$1
  shift
  mkdir -p "$build"
  if ! install_by_uv "$@" > "$build/uv.txt" 2>&1; then
    install_by_pip "$@" > "$build/pip.txt" 2>&1 || {
      cat "$build/pip.txt" >&2
      fail "the $name requirements could not be installed"
    }
  fi
}

# What only builds the workspace stays outside of the environment, and is installed where there is
# something to build; after the environment's own packages on the path, so that none is replaced.
install_build_tools() {
  local files=("$root/requirements/build.txt") tools=$build/tools id
  if [ "$source" = wheels ] && ! has_cmake; then files+=("$root/requirements/cmake.txt"); fi
  id="$(hash_of "${files[@]}") $(cat "$state/venv" 2>/dev/null || true)"
  if [ "$(cat "$tools/.lpv" 2>/dev/null)" != "$id" ]; then
    rm -rf "$tools" "$build/build"  # builds remember which CMake made them
    say "installing what builds the workspace"
    install_packages build --target "$tools" "${files[@]/#/-r}"
    mkdir -p "$tools" && echo "$id" > "$tools/.lpv"
  fi
  export PATH="$tools/bin:$PATH" PYTHONPATH="${PYTHONPATH:+$PYTHONPATH:}$tools"
}

# Whether the system's CMake and Ninja do: ament's macros want policies that CMake 4 has no more.
has_cmake() {
  local version
  command -v ninja >/dev/null || return 1
  version=$(cmake --version 2>/dev/null | sed -n 's/^cmake version //p')
  [ -n "$version" ] && printf '%s\n' 3.25 "$version" 3.999 | sort --check=quiet --version-sort
}

# The ROS wheels hold every library of theirs under each of its names, and what they depend on once
# a wheel: as wheels cannot hold links, 60 MB are there several times. Files below 100 kB are left.
link_duplicates() {
  hardlink --ignore-time --minimum-size 100000 "$venv" > "$build/hardlink.txt" 2>&1 || true
}

# Loads and unpacks many packages at once, in a quarter of pip's time; where pip is set up for an
# index of its own, uv uses that, and what uv cannot do is left to pip.  The system's certificates
# are trusted, as pip does; older versions of uv know them by another name.
install_by_uv() {
  [ "$source" = wheels ] || return 1  # uv does not see the packages of a sourced ROS 2
  local uv index links=${PIP_FIND_LINKS:-}
  uv=$(command -v uv) || {
    uv=$build/uv/bin/uv
    [ -x "$uv" ] || install_by_pip --target "$build/uv" 'uv>=0.4,<1' || return 1
  }
  index=$("$venv/bin/python" -m pip config get global.index-url 2>/dev/null) || index=
  UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-${PIP_INDEX_URL:-${index:-https://pypi.org/simple}}} \
    UV_FIND_LINKS=${UV_FIND_LINKS:-${links// /,}} UV_SYSTEM_CERTS=1 UV_NATIVE_TLS=1 \
    "$uv" pip install --python "$venv/bin/python" "$@"
}

install_by_pip() {
  "$venv/bin/python" -m pip install --disable-pip-version-check --no-compile --no-input "$@"
}

# Whether there is a ros2 command already; our stand-in in some environment is none.
has_ros2cli() {
  local found
  [ "$source" = sourced ] && return 0
  "$python" -c 'import ros2cli' 2>/dev/null && return 0
  found=$(command -v ros2) && ! grep -q "lpv[-_]ros2cli" "$found"
}

# What is not built any more is not found any more: packages that are parts of lpv and lpv_node now,
# and our ros2 command where a real one has come.
remove_packages() {
  local name
  for name in "$@"; do
    rm -rf "$venv"/lib/python*/site-packages/"$name"{,-*} "$venv"/{lib,share}/"$name" \
      "$venv/share/ament_index/resource_index/packages/$name"
  done
}

build_workspace() {
  local id stand_in=()
  has_ros2cli || stand_in=(../tools/lpv_ros2cli)
  id="$(source_hash)${stand_in[*]}"
  done_already workspace "$id" && return 0
  remove_packages lpv_{bag,campaign,cli,core,identify,report,view}
  if [ ${#stand_in[@]} -eq 0 ]; then
    rm -f "$venv/bin/ros2"
    remove_packages lpv_ros2cli
  fi
  say "building the workspace and compiling the numerical code: minutes, the first time"
  local options=() numerics
  # At the same time, from the sources: nothing here needs the other.
  PYTHONPATH="$root/ros2_ws/src/lpv${PYTHONPATH:+:$PYTHONPATH}" \
    "$venv/bin/python" -m lpv.core.simulation.precompile &
  numerics=$!
  trap "kill $numerics 2>/dev/null || true" EXIT  # it does not outlive a set-up that fails
  install_build_tools
  export PATH="$venv/bin:$PATH"
  if [ "$source" = wheels ]; then
    export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv VIRTUAL_ENV=$venv
    options+=(-G Ninja "-DCMAKE_PROJECT_INCLUDE=$root/tools/wheels_fix.cmake" -DLPV_MSGS_CPP=OFF)
  fi
  mkdir -p "$build"
  # Into the environment itself: programs then run with nothing sourced.
  if ! (cd "$root/ros2_ws" && "$venv/bin/python" -m colcon --log-base "$build/log" build \
      --base-paths src "${stand_in[@]}" \
      --merge-install --install-base "$venv" --build-base "$build/build" \
      --event-handlers console_cohesion- console_direct- console_stderr- \
      --cmake-args "${options[@]}" -DBUILD_TESTING=OFF \
      "-DPython3_EXECUTABLE=$venv/bin/python") > "$build/colcon.txt" 2>&1; then
    cat "$build/colcon.txt" >&2
    fail "the workspace did not build; see $build/log"
  fi
  keep_byte_code > "$build/byte_code.txt" 2>&1 || true  # nothing but time is lost
  wait "$numerics" || fail "the numerical code could not be compiled (see above)"
  trap - EXIT
  mark_done workspace "$id"
}

main() {
  check_paths
  choose_source
  check_machine
  make_venv
  if [ "$source" = wheels ]; then
    install_requirements base "$root/requirements/base.txt" "$root/requirements/ros2-wheels.txt"
  else
    install_requirements base "$root/requirements/base.txt"
  fi
  case "${1:-}" in
    '') ;;
    extras | test | bench | docs) install_requirements "$1" "$root/requirements/$1.txt" ;;
    *) fail "unknown argument $1; known are extras, test, bench and docs" ;;
  esac
  build_workspace
}

if [ "${BASH_SOURCE[0]}" = "$0" ]; then  # tests source this file
  main "$@"
fi
