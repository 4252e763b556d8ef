# SPDX-License-Identifier: Apache-2.0
"""The sorts of cases: share of each in a run, and what it is."""

SHARES = {
    'single': (0.36, 'with one effect'),
    'pair': (0.13, 'with two effects'),
    'triple': (0.04, 'with three effects'),
    'none': (0.14, 'with imperfections, and no effect'),
    'ideal': (0.05, 'with nothing at all'),
    'outside': (0.11, 'with a cause that the catalogue lacks'),
    'hidden': (0.05, 'with an effect too small or not excited'),
    'fault': (0.12, 'whose log contradicts the machine file'),
}
