#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Install what benchmarks compare with, and what the test beside MuJoCo needs, into build/peers: what
# is not the package's stays out of its environment. Does nothing where it is there.
set -euo pipefail
cd "${0%/*}/.."

cmp -s checks/benchmarks/peers.lock build/peers/.lock && exit
rm -rf build/peers
python -m pip install --quiet --no-input --no-deps --target build/peers -r checks/benchmarks/peers.lock
cp checks/benchmarks/peers.lock build/peers/.lock
