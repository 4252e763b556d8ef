# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.blind`."""

import sys

from checks.blind import command
from checks.program import start

if __name__ == '__main__':
    sys.exit(start('checks.blind', command))
