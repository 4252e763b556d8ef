# SPDX-License-Identifier: Apache-2.0
"""An MJCF compiled and stepped once, in a process that may die.

A few of its words ask MuJoCo for memory or time without end: `<replicate>`, `<size>`, `<hfield>`.
The text comes by the standard input. What the compiler warns of is written to the standard output;
what it refuses is no matter here, since it refuses that again.
"""

import resource
import sys

_BYTES, _SECONDS = 1 << 29, 5


def main() -> None:
    """Compile and step, within limits of memory and processor time."""
    import mujoco

    mujoco.set_mju_user_warning(print)
    with open('/proc/self/statm', encoding='ascii') as file:
        data = int(file.read().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (data + _BYTES, data + _BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    try:
        model = mujoco.MjModel.from_xml_string(sys.stdin.read())
    except ValueError:
        return
    mujoco.set_mju_user_warning(lambda text: None)
    mujoco.mj_step(model, mujoco.MjData(model))


if __name__ == '__main__':
    main()
