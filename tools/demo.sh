#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Replay a bag over DDS into a running identifier and show what it publishes, up to its result.
#
#   tools/demo.sh [BAG [MACHINE_FILE]]
#
# Ends with 0 only if a result with an estimate arrived on the topic.
set -euo pipefail
cd "${0%/*}/.."
bag=${1:-bags/tripod_pick_and_place}
machine=${2:-config/tripod.yaml}

# Nobody else's topics: a domain of its own, on this machine only.
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export ROS_DOMAIN_ID=${DEMO_DOMAIN_ID:-$((RANDOM % 90 + 10))}
# Each program says what is worth saying itself.
export RCUTILS_CONSOLE_OUTPUT_FORMAT='{name}: {message}'
results=${DEMO_RESULTS:-build/demo}

pids=()
finish() {
  local pid
  for pid in "${pids[@]}"; do kill -TERM "$pid" 2> /dev/null || true; done
  wait || true
}
trap finish EXIT

echo "demo: $bag goes over DDS (domain $ROS_DOMAIN_ID) into a running identifier."
python -m ros2_ident.ros.identifier --ros-args --log-level warn \
  -p machine_file:="$machine" -p output_directory:="$results" -p end_of_stream:=1.0 \
  -p initial_population:=512 -p workers:="$(nproc)" &
pids+=($!)
python tools/watch.py --seconds 240 &
watch=$!
pids+=("$watch")
python -m ros2_ident.ros.replay "$bag" --wait-for-subscribers 60 &
pids+=($!)

code=0
wait "$watch" || code=$?
if [ "$code" -eq 0 ]; then
  echo 'demo: that was the message on /identifier/result. Replay your own: see README.md.'
else
  echo "demo: no estimate arrived (code $code)." >&2
fi
exit "$code"
