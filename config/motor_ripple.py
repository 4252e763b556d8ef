# SPDX-License-Identifier: Apache-2.0
"""A further ripple of a motor's torque; copied under several names it is several.

The catalogue's own is for drives that move something: it is at most a quarter of the effort, and
one for a drive. The cogging of a motor without a load is most of its effort, and has several
orders. `ident diagnose BAG --machine odrive.yaml --effect motor_ripple.py --effect my_copy.py`
"""

from dataclasses import replace
from pathlib import Path

from ros2_ident.effects.torque_ripple import EFFECT as RIPPLE

SINE, COSINE, ORDER = RIPPLE.parameters
NAME = Path(__file__).stem

EFFECT = replace(
    RIPPLE,
    id=NAME,
    title=NAME.replace('_', ' '),
    parameters=(
        replace(SINE, low=-1.0, high=1.0),
        replace(COSINE, low=-1.0, high=1.0),
        ORDER,
    ),
    confusable=('torque_ripple',),
)
