# SPDX-License-Identifier: Apache-2.0
"""Messages lost and their latency: three 1 kHz streams into the node while the search runs.

A process of its own publishes JointState messages of three drives on three topics, 1 kHz each. The
node, built and run as `identifier` does, starts an identification and keeps receiving. Latency is
from DDS's stamp of publishing to when the callback has the message.

    python checks/benchmarks/latency.py [--seconds 20] [--realtime]

On a machine that others use too, their programs show in the figures. `--realtime` (as root) puts
them out of the way: everything runs at real-time priority, the threads that simulate do not.
"""

import argparse
import gc
import os
from pathlib import Path
import subprocess
import sys
import threading
import time

import numpy as np

from checks.benchmarks.measure import machine

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / 'bags/tripod_pick_and_place'
MACHINE = ROOT / 'config/tripod.yaml'
RATE = 1000
TOPICS = ('joint_states', 'effort', 'joint_command')


def publish(seconds: float) -> None:
    """Publish the streams, each message stamped when it is sent; runs in its own process."""
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    from ros2_ident.recording import cdr

    rclpy.init()
    node = Node('drives')
    publishers = [node.create_publisher(JointState, topic, 5000) for topic in TOPICS]
    while not all(p.get_subscription_count() for p in publishers):
        time.sleep(0.02)
    time.sleep(1.0)  # until the other side knows of us too
    names = ['drive_1', 'drive_2', 'drive_3']
    data = np.zeros((1, 3))
    template = bytearray(cdr.encode(np.zeros(1, dtype=np.int64), names, [data, data, data])[0])
    start = time.monotonic_ns()
    for k in range(round(seconds * RATE)):
        due = start + k * 1_000_000_000 // RATE
        left = (due - time.monotonic_ns()) * 1e-9
        if left > 0.0:
            time.sleep(left)
        for publisher in publishers:
            now = time.time_ns()
            template[4:8] = (now // 1_000_000_000).to_bytes(4, 'little')
            template[8:12] = (now % 1_000_000_000).to_bytes(4, 'little')
            publisher.publish(bytes(template))
    for publisher in publishers:
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=5.0))
    time.sleep(1.0)
    node.destroy_node()
    rclpy.shutdown()


def measure(seconds: float, workers: int, search: bool, realtime: bool) -> dict[str, float]:
    """Return what happened to the messages."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter
    from ros2_ident_msgs.action import Identify

    from ros2_ident.ros.identifier import SWITCH_INTERVAL
    from ros2_ident.ros.node import Identifier

    sys.setswitchinterval(SWITCH_INTERVAL)
    rclpy.init()
    values = {
        'machine_file': str(MACHINE),
        'output_directory': '',
        'auto_start': False,
        'workers': workers,
        'generations': 100000,  # the search has to outlast the streams
        'buffer_messages': 10_000_000,
    }
    if realtime:  # inherited by DDS's threads and the publishing process
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    node = Identifier(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ordinary = os.sched_param(0)
    node.worker.chore(
        lambda: os.sched_setscheduler(0, os.SCHED_OTHER, ordinary), lambda value, error: None
    )
    gc.collect()
    gc.freeze()
    latencies: list[int] = []
    node.capture.on_latency = latencies.append
    stop = threading.Event()
    bag = Identify.Goal(data_source=Identify.Goal.DATA_SOURCE_BAG, bag_path=str(BAG))
    if search:
        node.identifying.begin(bag)
        while node.diagnostics.progress is None:  # compiled, and in its first generation
            executor.spin_once()
        latencies.clear()
    before = os.times()
    process = subprocess.Popen([sys.executable, __file__, '--publish', str(seconds)])

    def wait() -> None:
        process.wait()
        stop.set()

    threading.Thread(target=wait, daemon=True).start()
    while not stop.is_set():
        executor.spin_once()
    after = os.times()
    running = node.worker.busy
    evaluations = node.diagnostics.progress.evaluations if search else 0
    node.stop()
    while node.worker.busy:
        executor.spin_once()
    node.worker.join(10.0)
    received = sum(meter.received for meter in node.capture.meters.values())
    node.destroy_node()
    rclpy.shutdown()
    assert running == search, 'the search ended before the streams'
    expected = round(seconds * RATE) * len(TOPICS)
    found = 1e-6 * np.array(latencies)
    return {
        'sent': expected,
        'lost': expected - received,
        'p50': float(np.percentile(found, 50)),
        'p99': float(np.percentile(found, 99)),
        'p999': float(np.percentile(found, 99.9)),
        'max': float(found.max()),
        'evaluations': evaluations,
        'cpu': after.user + after.system - before.user - before.system,
    }


def row(name: str, got: dict[str, float]) -> str:
    """Return a line of the table."""
    return (
        f'| {name} | {got["sent"]:.0f} | {got["lost"]:.0f} | {got["p50"]:.2f} | {got["p99"]:.2f} '
        f'| {got["p999"]:.2f} | {got["max"]:.1f} | {got["evaluations"]:.0f} |'
    )


def main() -> int:
    """Measure and print; return 1 where a message was lost or p99 is 2 ms or more."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0, help='length of the streams')
    parser.add_argument('--realtime', action='store_true', help='keep other programs out of it')
    parser.add_argument('--publish', type=float, help=argparse.SUPPRESS)
    parser.add_argument('--only', type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '231')
    if options.publish is not None:
        publish(options.publish)
        return 0
    cores = len(os.sched_getaffinity(0))
    cases = [
        ('no search', 0, False),
        (f'search, {max(1, cores - 1)} of {cores} simulate (default)', max(1, cores - 1), True),
        (f'search, {cores} of {cores} simulate', cores, True),
    ]
    if options.only is not None:
        cases = [cases[options.only]]
    where = machine()
    lines = [
        '| | sent | lost | p50 [ms] | p99 [ms] | p99.9 [ms] | longest [ms] | simulated |',
        '| --- | --- | --- | --- | --- | --- | --- | --- |',
    ]
    print('\n'.join(lines), flush=True)
    good = True
    for name, workers, search in cases:
        got = measure(options.seconds, workers, search, options.realtime)
        lines.append(row(name, got))
        print(lines[-1], f' cpu {got["cpu"]:.1f} s', flush=True)
        good = good and got['lost'] == 0 and (got['p99'] < 2.0 or workers == cores)
    print(where)
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
