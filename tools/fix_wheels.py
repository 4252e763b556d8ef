# SPDX-License-Identifier: Apache-2.0
"""Point the ROS wheels' CMake files at this environment's Python and NumPy headers.

The wheels were built in a container whose include folders are written into the exported targets
of every message package; CMake refuses targets whose include folders do not exist.
"""

from pathlib import Path
import re
import sys
import sysconfig

import numpy

HEADERS = (
    (re.compile(r'/opt/python/[^;"]*/numpy/_core/include'), numpy.get_include()),
    (re.compile(r'/opt/python/[^;"]*/include/python3\.\d+'), sysconfig.get_path('include')),
)


def main() -> None:
    """Rewrite the files; a second run changes nothing."""
    for path in Path(sys.prefix, 'share').glob('*/cmake/*_pyExport.cmake'):
        old = new = path.read_text(encoding='utf-8')
        for pattern, folder in HEADERS:
            new = pattern.sub(folder.replace('\\', r'\\'), new)
        if new != old:
            path.unlink()  # a link into uv's cache
            path.write_text(new, encoding='utf-8')


if __name__ == '__main__':
    main()
