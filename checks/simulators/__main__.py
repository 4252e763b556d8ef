# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.simulators`."""

import sys

from checks.program import start
from checks.simulators import command

if __name__ == '__main__':
    sys.exit(start('checks.simulators', command))
