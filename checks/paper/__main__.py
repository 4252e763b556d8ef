# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.paper`."""

import sys

from checks.paper import command
from checks.program import start

if __name__ == '__main__':
    sys.exit(start('checks.paper', command))
