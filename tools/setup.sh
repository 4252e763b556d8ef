#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Make everything the package runs on: .venv, and both packages built into install/.
#
# With ROS 2 Jazzy sourced, .venv adds only what ROS does not bring. Without, .venv gets ROS 2 from
# the ros-jazzy-* wheels; such an environment is a ROS prefix of its own (lib, share, ament index).
# Does only what is out of date, so it is cheap to call before everything else.
#
#   tools/setup.sh            set up
#   tools/setup.sh --check    exit with 0 if there is nothing to do; change nothing
set -euo pipefail
cd "${0%/*}/.."
root=$PWD

# Every foreseeable failure is one sentence with the remedy.
die() {
  printf 'setup: %s\n' "$*" >&2
  exit 1
}
trap 'die "tools/setup.sh failed at line $LINENO; please report this."' ERR
say() { printf 'setup: %s (%d s)\n' "$*" "$SECONDS"; }

# Say what keeps a Python from being used; print nothing for a usable one.
unfit='
import importlib.util as util, os, platform, sys, sysconfig
version = ".".join(map(str, sys.version_info[:3]))
header = os.path.join(sysconfig.get_path("include"), "Python.h")
if not (3, 11) <= sys.version_info[:2] <= (3, 13):
    print("is version " + version)
elif platform.system() != "Linux" or platform.machine() != "x86_64":
    print("runs on " + platform.system() + " " + platform.machine())
elif not (util.find_spec("venv") and util.find_spec("ensurepip")):
    print("has no module venv")
elif not os.path.exists(header):
    print("has no C headers")
'

find_python() {
  local candidate reason first=''
  for candidate in ${PYTHON:-python3.11 python3 python3.12 python3.13}; do
    command -v "$candidate" > /dev/null || continue
    reason=$("$candidate" -c "$unfit" 2> /dev/null || echo 'does not start')
    [ -n "$reason" ] || { python=$(command -v "$candidate"); return; }
    first=${first:-"$candidate $reason"}
  done
  die "no usable Python (${first:-${PYTHON:-python3} not found}); the ROS 2 wheels need Python" \
    '3.11 to 3.13 on x86-64 Linux with venv and headers, so install it' \
    '(Debian: apt install python3-venv python3-dev) or set PYTHON to one that fits.'
}

find_first() {
  local candidate
  for candidate; do
    if command -v "$candidate" > /dev/null; then return; fi
  done
  return 1
}

# --- what is there ---

[ -f msg_defs/package.xml ] ||
  die 'the interface package msg_defs/ is missing; restore it with: git checkout -- msg_defs'
{ find_first "${CXX:-c++}" g++ clang++ && find_first "${CC:-cc}" gcc clang; } ||
  die 'no C++ compiler found; install one (Debian: apt install build-essential).'
find_first make ||
  die 'make not found; install it (Debian: apt install build-essential).'

# env.sh leaves ROS_DISTRO alone, so it is set only where a ROS installation was sourced.
if [ -n "${ROS_DISTRO:-}" ]; then
  mode=sourced
  [ "$ROS_DISTRO" = jazzy ] ||
    die "ROS 2 $ROS_DISTRO is sourced, not Jazzy; source Jazzy, or start from a shell without ROS."
  python=$(command -v python3 || true)
  { [ -n "$python" ] && "$python" -c 'import rclpy' 2> /dev/null; } ||
    die "ROS 2 Jazzy is sourced but ${python:-python3} cannot import rclpy;" \
      'put the Python that ROS was built for (/usr/bin/python3) first on PATH.'
  for tool in colcon cmake; do
    command -v $tool > /dev/null ||
      die "$tool not found; install it (Ubuntu: apt install ros-dev-tools)."
  done
else
  mode=wheels
  if [ -x .venv/bin/python ] && [ -z "$(.venv/bin/python -c "$unfit" 2>&1)" ]; then
    python=$root/.venv/bin/python
  else
    find_python
  fi
fi

# --- what is out of date ---

hash_of() { sha256sum "$@" | sha256sum | cut -c 1-16; }
venv_stamp="$mode $root $("$python" -c 'import sys; print(sys.version.split()[0])') $(
  hash_of requirements*.in requirements.lock tools/fix_wheels.py)"
# Installed files are links into the sources; only their list and the messages need a new build.
# shellcheck disable=SC2046 # no spaces in these names
build_stamp="$venv_stamp $(
  hash_of $(find msg_defs -type f | sort) setup.py setup.cfg package.xml colcon_defaults.yaml) $(
  { find config launch bags -type f 2> /dev/null || true; } | sort | sha256sum | cut -c 1-16)"

is() { [ "$(cat "$1" 2> /dev/null)" = "$2" ]; }
current() { is .venv/.stamp "$venv_stamp" && is install/.stamp "$build_stamp"; }

if current; then exit 0; fi
[ "${1:-}" != --check ] || die 'the environment is not up to date; run `make setup`.'

mkdir -p build
log=$root/build/setup.log
if command -v flock > /dev/null; then # two shells setting up at once would tread on each other
  exec 9> build/setup.lock
  flock -n 9 || { say 'waiting for another set-up of this tree'; flock 9; }
  if current; then exit 0; fi
fi
: > "$log"

# Run a step with its output in the log; on failure show the end of it and one sentence.
step() {
  local remedy=$1
  shift
  "$@" >> "$log" 2>&1 9>&- && return
  tail -n 25 "$log" >&2
  die "$remedy The whole output is in build/setup.log."
}

# --- the environment ---

# What the calling shell has on its search paths must not leak in.
if [ "$mode" = wheels ]; then
  unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH
  unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
fi

# A new lock file is installed over the old one; anything else means a new environment.
make_venv() {
  is .venv/.made_for "$mode $root" && [ "$python" = "$root/.venv/bin/python" ] && return
  step "$python cannot make a virtual environment; install its module venv." \
    "$python" -m venv --clear "$@" .venv
  echo "$mode $root" > .venv/.made_for
}

# Every file is held against its hash. uv takes a fraction of pip's time, but does not know pip's
# settings, by which another index may be the only one within reach. Files are links into its cache.
install_locked() {
  sed -n '/^uv==/,/[^\\]$/p' requirements.lock > build/uv.lock
  local words=(install --no-deps --require-hashes -r)
  .venv/bin/python -m pip "${words[@]}" build/uv.lock --no-input || return
  .venv/bin/uv pip "${words[@]}" requirements.lock --python .venv/bin/python ||
    .venv/bin/python -m pip "${words[@]}" requirements.lock --no-input
}

if ! is .venv/.stamp "$venv_stamp"; then
  rm -f .venv/.stamp
  if [ "$mode" = wheels ]; then
    say "installing ROS 2 Jazzy and $(grep -c == requirements.lock) packages into .venv"
    make_venv
    step 'Some packages could not be installed; check the network and try again.' install_locked
    .venv/bin/python tools/fix_wheels.py
  else
    say 'installing what ROS 2 Jazzy does not bring into .venv'
    make_venv --system-site-packages
    # ROS's own extensions are compiled for the NumPy they came with: keep it, and with it whatever
    # else of the numeric packages is installed.
    sed -n 's/^\([^ ]*==[^ ]*\).*/\1/p' requirements.lock |
      grep -vE '^(numpy|scipy|matplotlib|contourpy|setuptools|empy|ros-)' > build/constraints.txt
    "$python" -c 'import numpy; print("numpy==" + numpy.__version__)' >> build/constraints.txt ||
      die 'ROS 2 Jazzy is sourced but numpy is missing; install it (Ubuntu: apt install python3-numpy).'
    step 'Some packages could not be installed; check the network and try again.' \
      .venv/bin/python -m pip install --no-input -c build/constraints.txt -r requirements.in
  fi
  echo "$venv_stamp" > .venv/.stamp
fi

# --- both packages ---

if ! is install/.stamp "$build_stamp"; then
  say 'building ros2_ident_msgs and ros2_ident into install/'
  # Another mode's or another Python's build cannot be continued.
  is build/.venv_stamp "$venv_stamp" || rm -rf build/ros2_ident build/ros2_ident_msgs install
  echo "$venv_stamp" > build/.venv_stamp
  # colcon does not remove links to files that are gone.
  rm -rf install/ros2_ident/share/ros2_ident/{config,launch,bags}
  export VIRTUAL_ENV=$root/.venv
  . tools/paths.sh
  # colcon runs under .venv's Python, so that is what the installed programs start with.
  defines=(-DPython3_EXECUTABLE="$root/.venv/bin/python" -DBUILD_TESTING=OFF)
  [ "$mode" = sourced ] || defines+=(-DWITHOUT_CPP=ON) # nothing here is built against the wheels
  step 'The packages could not be built.' \
    env MAKEFLAGS="-j$(getconf _NPROCESSORS_ONLN)" \
    .venv/bin/python "$(command -v colcon)" --log-base build/log build --symlink-install \
    --event-handlers console_direct+ --cmake-args "${defines[@]}"
  echo "$build_stamp" > install/.stamp
fi
# The first run on a kind of machine compiles its simulation: let that be done by whom nobody waits
# for, and nobody hears.
nohup nice -n 19 tools/compile.sh < /dev/null > /dev/null 2>&1 9>&- &
say 'done; now `. ./env.sh`'
