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
root=$(cd "$(dirname "$ident_file")" && pwd)

if [ ! -f "$root/install/.stamp" ]; then
  echo "env.sh: $root is not set up; run \`make setup\` there first." >&2
  unset root ident_file ident_shell
  return 1
fi

. "$root/tools/paths.sh"

# colcon's scripts read variables that need not be set.
case $- in *u*) ident_nounset=1; set +u ;; *) ident_nounset= ;; esac
if [ -d "$VIRTUAL_ENV/share/rclpy" ]; then
  # Messages of a shell on this machine are nobody else's business; say otherwise beforehand.
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
  COLCON_CURRENT_PREFIX="$root/install"
  . "$root/install/local_setup.$ident_shell"
else
  COLCON_CURRENT_PREFIX="$root/install"
  . "$root/install/setup.$ident_shell" # also sources the ROS 2 that it was built on
fi
unset COLCON_CURRENT_PREFIX
[ -z "$ident_nounset" ] || set -u

# `ros2 run` looks here; the wheels bring no `ros2`, so the programs are commands too.
ident_prepend PATH "$root/install/ros2_ident/lib/ros2_ident"

unset root ident_file ident_shell ident_nounset
unset -f ident_prepend
