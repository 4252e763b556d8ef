# SPDX-License-Identifier: Apache-2.0
"""Show what an identifier publishes until its next result, for the demo.

Exit codes: 0 for a result with an estimate, 1 for any other, 2 when none came in time.
"""

import argparse
from collections.abc import Sequence
import math
import signal
import sys
import time
from typing import Any

from ros2_ident.ros.identifier import missing, Stop

_GOOD = ('CONVERGED', 'STAGNATED', 'AT_BOUND', 'NOT_IDENTIFIABLE')


def main(args: Sequence[str] | None = None) -> int:
    """Watch a node until it has a result; return the exit code."""
    stop = Stop()
    parser = argparse.ArgumentParser(
        prog='watch', description='Show progress and result of an identifier.'
    )
    parser.add_argument('--node', default='/identifier', help='full name of the node')
    parser.add_argument('--seconds', type=float, default=math.inf, help='give up after this time')
    options = parser.parse_args(args)
    try:
        return _watch(options, stop)
    except ModuleNotFoundError as error:
        print(f'watch: {missing(error)}', file=sys.stderr)
        return 1


def _watch(options: argparse.Namespace, stop: Stop) -> int:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from ros2_ident_msgs.msg import IdentificationResult, Progress, Status

    from ros2_ident.ros.outlet import LATCHED

    results: list[Any] = []
    shown = Shown()
    said: list[str] = []

    def on_status(message: Any) -> None:
        # the search's own words come with its progress
        if message.state != Status.STATE_IDENTIFYING and message.sentence not in said[-1:]:
            said.append(message.sentence)
            print(f'status    {message.sentence}', flush=True)

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node('watch')
        name = options.node.rstrip('/')
        node.create_subscription(Progress, f'{name}/progress', shown, 10)
        node.create_subscription(Status, f'{name}/status', on_status, LATCHED)
        node.create_subscription(IdentificationResult, f'{name}/result', results.append, LATCHED)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        deadline = time.monotonic() + options.seconds
        while not results and not stop.signal and time.monotonic() < deadline:
            executor.spin_once(0.1)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    if not results:
        print(f'watch: no result of {options.node} came', file=sys.stderr)
        return 128 + stop.signal if stop.signal == signal.SIGINT else 2
    print(table(results[0]), flush=True)
    good = {getattr(IdentificationResult, f'OUTCOME_{outcome}') for outcome in _GOOD}
    return 0 if results[0].error_code == 0 and results[0].outcome in good else 1


class Shown:
    """Prints progress, a line for each generation and at least one a second."""

    def __init__(self) -> None:
        self._last: tuple[int, int] = (-1, -1)
        self._next = 0.0

    def __call__(self, message: Any) -> None:
        """Take a progress message."""
        now = time.monotonic()
        place = (message.phase, message.generation)
        if place == self._last and now < self._next:
            return
        self._last, self._next = place, now + 1.0
        print(progress_line(message), flush=True)


def progress_line(message: Any) -> str:
    """Return a progress message as a line."""
    phase = ('search', 'refine')[message.phase]
    eta = '' if math.isnan(message.eta) else f', about {message.eta:.0f} s to go'
    return (
        f'{phase:9} {message.generation:2d} of {message.generations}, '
        f'{message.evaluations} simulated, best cost {message.best_cost:.5g} {message.cost_unit}'
        f'{eta}'
    )


def table(message: Any) -> str:
    """Return a result message as a table."""
    lines = [f'result    {message.outcome_sentence or message.error_message}']
    if not message.parameters:
        return lines[0]
    wide = max(len(p.name) for p in message.parameters)
    lines.append(f'  {"parameter":{wide}}  {"value":>11}  95 % interval            unit')
    for p in message.parameters:
        note = f'   {p.note}' if p.note else ''
        lines.append(
            f'  {p.name:{wide}}  {p.value:11.5g}  '
            f'{f"{p.low:.5g} to {p.high:.5g}":24} {p.unit}{note}'
        )
    lines.append(
        f'  cost {message.cost_genetic:.5g} {message.cost_unit} after the genetic algorithm, '
        f'{message.cost_refined:.5g} refined; {message.evaluations} simulations, '
        f'{message.seconds:.1f} s'
    )
    if message.missing_fraction > 0.0:
        lines.append(f'  {100 * message.missing_fraction:.2g} % of the samples are missing')
    if message.result_file:
        lines.append(f'  {message.result_file}')
    return '\n'.join(lines)


if __name__ == '__main__':
    sys.exit(main())
