# shellcheck shell=sh disable=SC2154
# SPDX-License-Identifier: Apache-2.0
# Sourced by setup.sh and env.sh, with VIRTUAL_ENV exported: the search paths for it.

# Put a folder in front of a search path, once.
ident_prepend() {
  eval "ident_old=\${$1:-}"
  case ":$ident_old:" in
    *":$2:"*) ;;
    *) eval "export $1=\"\$2\${ident_old:+:\$ident_old}\"" ;;
  esac
  unset ident_old
}

unset PYTHONHOME
ident_prepend PATH "$VIRTUAL_ENV/bin"

# Made of wheels, .venv is the ROS installation, and its libraries must be found. (Otherwise the
# wheels' .pth file restarts every Python to set LD_LIBRARY_PATH; the last variable tells it that
# this is done.)
if [ -d "$VIRTUAL_ENV/share/rclpy" ]; then
  ident_prepend AMENT_PREFIX_PATH "$VIRTUAL_ENV"
  for ident_folder in "$VIRTUAL_ENV"/lib/python3.*/site-packages/ros_*.libs "$VIRTUAL_ENV/lib"; do
    ident_prepend LD_LIBRARY_PATH "$ident_folder"
  done
  unset ident_folder
  export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
fi
