#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# mcap-ros2-support cannot write a field whose definition gives an array as its default.
#
# mcap-ros2-support 0.6.0 with mcap 1.6.0, a message with the gains of a joint. A default that is
# one number is honoured: kp, left out, is written as 1.5. Of an array it is not: two gains left
# out become an array of none, where ROS 2 makes it [1.0, 2.0], so that the bag says something else
# than the publisher of the same message. And where the array IS given the writer ends with
# "Default value for primitive types cannot be an array", whatever is in it: no message of such a
# type gets into a bag with gains of its own. The same of a fixed-size array, given or not.
#
# Source: https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html, "Field default value"
# (its example: `int32[] samples [-200, -100, 0, 100, 200]`); mcap_ros2/_dynamic.py, line 599, is
# called for each item of an array with the whole default (line 635).
#
# Output seen:
#   kp 1.5, left out: 1.5
#   float64[] gains [1.0, 2.0], left out: []
#   float64[] gains [1.0, 2.0], given [3.0]: ValueError
#   float64[2] gains [1.0, 2.0], given [3.0, 4.0]: ValueError
#   float64[] gains, given [3.0]: [3.0]
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet mcap-ros2-support==0.6.0 mcap==1.6.0
cat > "$folder/defaults.py" << 'END'
import sys

from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer


def through(definition, message):
    """Return what is read of a message that was written; the error's name where none was."""
    path = sys.argv[1] + '/log.mcap'
    with open(path, 'wb') as file:
        writer = Writer(file)
        schema = writer.register_msgdef('joint_msgs/msg/Gains', definition)
        try:
            writer.write_message('/gains', schema, message, log_time=0, publish_time=0)
        except ValueError as error:
            return type(error).__name__
        finally:
            writer.finish()
    (own,) = read_ros2_messages(path)
    return own.ros_msg


kp = through('float64 kp 1.5\nfloat64 kd\n', {'kd': 2.0}).kp
print(f'kp 1.5, left out: {kp}')
assert kp == 1.5
for definition, given, due in (
    ('float64[] gains [1.0, 2.0]', None, []),
    ('float64[] gains [1.0, 2.0]', [3.0], 'ValueError'),
    ('float64[2] gains [1.0, 2.0]', [3.0, 4.0], 'ValueError'),
    ('float64[] gains', [3.0], [3.0]),
):
    found = through(definition + '\n', {} if given is None else {'gains': given})
    seen = found if isinstance(found, str) else list(found.gains)
    print(f'{definition}, ' + ('left out' if given is None else f'given {given}') + f': {seen}')
    assert seen == due, seen
END
"$folder/env/bin/python" "$folder/defaults.py" "$folder"
