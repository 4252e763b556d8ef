# SPDX-License-Identifier: Apache-2.0
"""What the node looks at when it starts: its machine file, what it heard before, its name."""

from typing import Any

from ros2_ident_msgs.msg import Status

from ros2_ident.errors import IdentError
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag, Topics
from ros2_ident.recording.spool import Spool
from ros2_ident.ros.parameters import Snapshot
from ros2_ident.ros.paths import expanded

# The node is any that has the parts of `node.Identifier`, which imports this.
Node = Any


def look_at_machine(node: Node, path: str) -> None:
    """Say at once what is wrong with the machine file; a goal may name another one."""
    if not path:
        return
    try:
        load_machine(expanded(path))
    except IdentError as error:
        node.board.refuse(error)


def spool_of(node: Node, now: Snapshot) -> Spool | None:
    """Return the file to which what arrives is written as well; None for none."""
    if not (now['output_directory'] and now['spool_size']):
        return None
    name = node.get_fully_qualified_name().strip('/').replace('/', '.')
    try:
        folder = expanded(now['output_directory']) / 'spool'
        return Spool(folder / f'{name}.mcap', 1_000_000 * now['spool_size'])
    except IdentError as error:
        node.get_logger().warning(f'what arrives is not spooled: {error.message}')
        return None


def find_again(node: Node) -> None:
    """Read what was heard before a restart, if nothing is heard by then."""
    capture = node.capture
    if capture.spool is None or capture.spool.empty:
        return
    path = capture.spool.path
    where = Topics(**capture.topics, names=capture.names, so_far=True)

    def found(recordings: Any, error: BaseException | None) -> None:
        if error is not None:
            text = error.message if isinstance(error, IdentError) else str(error)
            node.get_logger().warning(f'what was heard before the start is lost: {text}')
        elif capture.empty:
            capture.restore(recordings)
            count = sum(meter.received for meter in capture.meters.values())
            node.board.change(
                Status.STATE_READY,
                f'{count} messages from before the start are held ({path}); send a goal to '
                '~/identify or ~/diagnose, replay anew, or call ~/clear_data',
            )

    node.worker.chore(lambda: read_bag(path, where), found)


def look_for_twins(node: Node) -> bool:
    """Say that another node has the same name, if so: their topics and services are mixed up."""
    own = (node.get_name(), node.get_namespace())
    if node.get_node_names_and_namespaces().count(own) < 2:
        return False
    node.get_logger().warning(
        f'another node is named {node.get_fully_qualified_name()} too, and both answer; end one '
        'of them or start it with --ros-args -r __node:=another_name'
    )
    return True
