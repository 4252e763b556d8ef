# SPDX-License-Identifier: Apache-2.0
"""The build of the wheel: setuptools', with setup.py told what it is asked for.

A variable, since all hooks (metadata, wheel, sdist) have to see the same.
"""

import os

os.environ['ROS2_IDENT_WHEEL'] = '1'

from setuptools.build_meta import *  # noqa: E402, F403
