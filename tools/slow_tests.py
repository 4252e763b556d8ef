# SPDX-License-Identifier: Apache-2.0
"""Write test/slow.txt from the durations that a run of all tests leaves in CI.

python tools/slow_tests.py build/durations.txt
"""

from collections import Counter
from pathlib import Path
import re
import sys

ROOT = Path(__file__).parents[1]
# From here on a test is slow, s.
SLOW = 0.25
HEAD = (
    '# What is marked `slow`: tests of {slow:g} s and more where everything is compiled, and\n'
    '# files whose fixtures take as long; longest file first. Written by tools/slow_tests.py.\n'
)


def slow_of(log: str) -> list[str]:
    """Return the lines of the list, the longest file first, for the output of pytest."""
    files, tests = set(), set()
    whole: Counter[str] = Counter()
    for seconds, phase, name in re.findall(r'^([\d.]+)s (\w+) +(\S.*)$', log, re.MULTILINE):
        test = name.strip().removeprefix('checks/').removeprefix('test/').partition('[')[0]
        file = test.partition('::')[0]
        whole[file] += float(seconds)
        if float(seconds) >= SLOW:
            files |= {file} if phase == 'setup' else set()
            tests |= {test}
    lines = files | {test for test in tests if test.partition('::')[0] not in files}
    return sorted(lines, key=lambda line: (-whole[line.partition('::')[0]], line))


if __name__ == '__main__':
    text = '\n'.join(slow_of(Path(sys.argv[1]).read_text(encoding='utf-8')))
    head = HEAD.format(slow=SLOW)
    (ROOT / 'test/slow.txt').write_text(f'{head}{text}\n', encoding='utf-8')
