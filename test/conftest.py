# SPDX-License-Identifier: Apache-2.0
"""What holds for every test: those marked `ros` need ROS, and none talks beyond this machine."""

import importlib
import os

from hypothesis import settings
import pytest

# The same examples in every run: what they find is to be mended when a test is written, not when
# somebody else's change is tested. HYPOTHESIS_RANDOM=1 looks for new ones.
settings.register_profile('fixed', derandomize=not os.environ.get('HYPOTHESIS_RANDOM'))
settings.load_profile('fixed')

os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    marked = [item for item in items if item.get_closest_marker('ros')]
    if not marked:
        return
    try:
        importlib.import_module('rclpy')
        importlib.import_module('ros2_ident_msgs.msg')
    except ImportError as error:
        skip = pytest.mark.skip(reason=f'{error}; run `make test`, or source env.sh first')
        for item in marked:
            item.add_marker(skip)
