# SPDX-License-Identifier: Apache-2.0
"""What the signs of equations mean."""

from collections.abc import Iterable
import re

# In the order in which they are told.
MEANINGS = {
    'v': 'motor speed',
    'z': 'motor position',
    'z_cmd': 'set-point',
    's': 'position of the load side',
    'M': 'torque',
    'M_log': 'logged effort',
    'F': 'force on the gear',
    'gear': 'force on the gear over motor torque',
    't': 'time since the log began',
    'm_t': 'mass of the tool',
    'c_G': 'stiffness of the gear',
    'k_p': 'position gain',
    'k_v': 'velocity gain',
    'k_I': 'integral gain',
}
_SIGN = re.compile(r'[A-Za-z]+(?:_\w+)?')


def legend(laws: Iterable[tuple[str, Iterable[str]]]) -> list[tuple[str, str]]:
    """Return the signs that equations use and do not explain, each with its meaning.

    Args:
        laws: Equation and the signs of its own parameters, which stand beside it.
    """
    used: set[str] = set()
    for equation, own in laws:
        used |= {*_SIGN.findall(equation)} - {*own}
    return [(sign, meaning) for sign, meaning in MEANINGS.items() if sign in used]
