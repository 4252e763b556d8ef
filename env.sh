# shellcheck shell=bash disable=SC1090,SC1091
# SPDX-License-Identifier: Apache-2.0
# `. ./env.sh` (bash, zsh or sh) gives a shell in which `ident`, `identifier`, `replay` and the
# Python packages rclpy, ros2_ident and ros2_ident_msgs are found. Sourcing it twice does no harm.

if [ -n "${BASH_VERSION:-}" ]; then
  ident_file=${BASH_SOURCE[0]} ident_shell=bash
elif [ -n "${ZSH_VERSION:-}" ]; then
  eval 'ident_file=${(%):-%x}' ident_shell=zsh
else
  ident_file=$PWD/env.sh ident_shell=sh # a plain shell does not tell; be in the folder
fi
ident_root=$(cd "$(dirname "$ident_file")" && pwd)

if [ ! -f "$ident_root/install/.stamp" ]; then
  echo "env.sh: $ident_root is not set up; run \`make setup\` there first." >&2
  unset ident_root ident_file ident_shell
  return 1
fi

export VIRTUAL_ENV="$ident_root/.venv"
. "$ident_root/tools/paths.sh"
if [ -d "$VIRTUAL_ENV/share/rclpy" ]; then
  # Talk to programs on this machine only, unless told otherwise beforehand.
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
fi

# colcon's scripts read variables that need not be set.
case $- in *u*) ident_nounset=1; set +u ;; *) ident_nounset= ;; esac
. "$ident_root/install/setup.$ident_shell" # where ROS 2 was sourced to build it, also that ROS 2
[ -z "$ident_nounset" ] || set -u

# What is run from a clone: `python -m checks.blind`, and what scripts take from there.
ident_prepend PYTHONPATH "$ident_root"
# `ros2 run` looks here; the wheels bring no `ros2`, so the programs are commands too.
ident_prepend PATH "$ident_root/install/ros2_ident/lib/ros2_ident"

unset ident_root ident_file ident_shell ident_nounset
unset -f ident_prepend
