# SPDX-License-Identifier: Apache-2.0
"""What a number of straight motion is where a joint turns: what is looked for in metres there."""

import re

# Lever that makes a way of an angle, m: the radius of a common pulley or pinion. What is looked
# for of a carriage is looked for of the joint that would drive it by this lever: 1 m is 20 rad,
# Stribeck speeds from 0.1 rad/s (5 mm/s) to 4 rad/s, steps of encoders up to those of 11 bits.
LEVER = 0.05
_POWER = {'kg': 2, 'N': 1, 'm': -1}


def angular_factor(unit: str) -> float:
    """Return the factor from a number of straight motion to one of a joint that turns.

    Args:
        unit: Unit of the number: `m/s` gives 20, `N/m` gives 1/400, `s` gives 1.
    """
    above, _, below = unit.partition('/')
    power = 0
    for sign, part in ((1, above), (-1, below)):
        for name, exponent in re.findall(r'\b(kg|N|m)\b(?:\^(\d+))?', part):
            power += sign * _POWER[name] * int(exponent or 1)
    return float(LEVER**power)


def per_metre(unit: str) -> float:
    """Return how much travel in `m` or `rad` stands for a metre."""
    return angular_factor('m') if unit == 'rad' else 1.0
