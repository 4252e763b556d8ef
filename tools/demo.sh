#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Placeholder: the demonstration of `make demo` goes here.
echo 'demo: not written yet; `make test` works.' >&2
exit 1
