# SPDX-License-Identifier: Apache-2.0
"""Numbers that several judgements share: one idea has one number."""

# How many of these are one rad or one m.
UNITS = {'rad': ((57.29578, 'degrees'), (0.1591549, 'turns')), 'm': ((1000.0, 'mm'),)}


def figure(value: float, sign: str = '') -> str:
    """Return a number with two digits that tell, as an engineer writes it: 280, not 2.8e+02."""
    return f'{float(f"{value:.2g}"):{sign}g}'
