# SPDX-License-Identifier: Apache-2.0
"""The node `identifier`: brings together what it hears, the worker, and what it says."""

import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future
from ros2_ident_msgs.action import Identify
from ros2_ident_msgs.msg import Status
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.jobs import Compared, Diagnosed, Identified
from ros2_ident.recording import read_bag, RecordingBuilder, Stream, Topics
from ros2_ident.recording.write import Spool
from ros2_ident.ros import parameters
from ros2_ident.ros.actions import DiagnoseServer, DiffServer, IdentifyServer, REQUESTS
from ros2_ident.ros.capture import Capture
from ros2_ident.ros.diagnostics import Diagnostics
from ros2_ident.ros.outlet import Board, LATCHED, Outlet, PageWriter, unwritten_pages
from ros2_ident.ros.run import expanded, save
from ros2_ident.ros.worker import Worker

TICK = 0.1  # s
# With a message as young as this one, s, data is arriving.
RECEIVING = 0.5
# Silence is explained this often, s.
EXPLAIN = 5.0


class Identifier(Node):
    """Identifies drives and diagnoses gaps from what it hears or from bags, one run at a time.

    Raises:
        IdentError: Where a parameter has a value it cannot have.
    """

    def __init__(self, node_name: str = 'identifier', **options: Any) -> None:
        super().__init__(node_name, **options)
        parameters.declare(self)
        for sentence in parameters.unknown(self):
            self.get_logger().warning(sentence)
        now = parameters.snapshot(self)
        # /clock stops with the bag, and every timer on it: these go by the steady clock
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.worker = Worker(self, steady)
        self.pages = PageWriter()
        self.outlet = Outlet(self, steady)
        self.diagnostics = Diagnostics(self.get_name(), now['missing_warning'])
        self.last: Identified | Diagnosed | Compared | None = None
        self.description: str | None = None
        self.stopping = False
        self._due = False  # a stream has ended while a run was going on
        self._ticks = 0
        self._explained = time.monotonic()
        self.identifying = IdentifyServer(self)
        self._servers = self.identifying, DiagnoseServer(self), DiffServer(self)
        self.create_service(Trigger, '~/clear_data', self._clear_data, qos_profile=REQUESTS)
        # it awaits what other callbacks bring, and would shut them out in the node's own group
        self.create_service(
            Trigger,
            '~/save_result',
            self._save_result,
            qos_profile=REQUESTS,
            callback_group=ReentrantCallbackGroup(),
        )
        self.create_subscription(String, 'robot_description', self._described, LATCHED)
        self._timer = self.create_timer(TICK, self._tick, clock=steady)
        self.add_on_set_parameters_callback(parameters.check_change)
        # last: what arrives before the executor spins has to fit into the queues
        self.capture = Capture(
            self,
            limit=now['buffer_messages'],
            keep_streams=now['keep_streams'],
            names=now['joint_names'],
            spool=self._spool(now),
        )
        self.board = Board(self)
        self.board.publish()
        self.add_post_set_parameters_callback(lambda _: self._parameters_changed())
        for name, value in now.items():  # said at once; a goal may name another machine file
            try:
                parameters.check_path(name, value)
            except IdentError as error:
                self.board.refuse(error)
        self._restore_spool()

    def _described(self, message: String) -> None:
        """Keep what is heard of the robot, for machine files that ask for it."""
        self.description = message.data

    def _spool(self, now: parameters.Snapshot) -> Spool | None:
        """Return the file to which what arrives is written as well; None for none."""
        if not (now['output_directory'] and now['spool_size']):
            return None
        name = self.get_fully_qualified_name().strip('/').replace('/', '.')
        try:
            folder = expanded(now['output_directory']) / 'spool'
            return Spool(folder / f'{name}.mcap', 1_000_000 * now['spool_size'])
        except IdentError as error:
            self.get_logger().warning(f'what arrives is not spooled: {error.message}')
            return None

    def _restore_spool(self) -> None:
        """Restore the spooled recording unless new messages have arrived."""
        capture = self.capture
        if capture.spool is None or capture.spool.empty:
            return
        path = capture.spool.path
        where = Topics(**capture.topics, names=capture.names, so_far=True)

        def found(recordings: Any, error: BaseException | None) -> None:
            if error is not None:
                text = error.message if isinstance(error, IdentError) else str(error)
                self.get_logger().warning(f'what was heard before the start is lost: {text}')
            elif capture.empty:
                capture.restore(recordings)
                self.board.change(
                    Status.STATE_READY,
                    f'{capture.received} messages from before the start are held ({path}); send a '
                    'goal to ~/identify or ~/diagnose, replay anew, or call ~/clear_data',
                )

        self.worker.chore(lambda: read_bag(path, where), found)

    # ------------------------------------------------------------------ runs

    @property
    def receiving(self) -> bool:
        """Whether messages have arrived just now, which must not wait for the simulation."""
        return self.capture.idle < RECEIVING

    def received(self) -> RecordingBuilder:
        """Return what has been received.

        Raises:
            IdentError: NO_DATA where that is nothing.
        """
        if self.capture.empty:
            raise ErrorCode.NO_DATA.error(f'{self.capture.silence()}; or name a bag to read')
        return self.capture.snapshot()

    def states(self) -> Stream | None:
        """Return the motion that has been received; raises as `received`."""
        return self.received().build()[0].state

    def occupation(self) -> str:
        """Return what runs now as words for a sentence, empty for nothing."""
        if self.stopping:
            return 'the end of the node'
        if self.worker.busy:
            return self.board.sentence
        return 'a goal that is about to start' if any(s.pending for s in self._servers) else ''

    def stop(self) -> None:
        """Ask a run to end with the best so far, and begin nothing new."""
        self.stopping = True
        self.worker.cancel()

    def destroy_node(self) -> None:
        """Take the node off the air; what it has heard is whole on the disk."""
        self.capture.close()
        if left := self.pages.left():
            self.get_logger().warning(unwritten_pages(left))
        super().destroy_node()

    @property
    def answered(self) -> bool:
        """Whether every goal has its result."""
        return not self.worker.busy and not any(server.open for server in self._servers)

    def give_up(self) -> None:
        """Answer all goals although a run has not ended."""
        error = ErrorCode.CANCELLED.error(
            'the node was ended, and the run did not end in time; send the goal again'
        )
        for server in self._servers:
            server.give_up(error)

    def spin(self, executor: Executor, seconds: float | None = None) -> None:
        """Let one callback run; what it raises is logged, and the node goes on.

        Args:
            seconds: Longest wait for one; without end where None.
        """
        try:
            executor.spin_once(seconds)
        except ExternalShutdownException:
            raise
        except Exception as error:
            self.board.stumbled(error)

    # ------------------------------------------------------------------ services, parameters

    def _clear_data(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.capture.flush()  # or what is not decoded yet is forgotten without a count
        count = self.capture.received
        self.capture.clear()
        if not self.worker.busy:
            self.board.change(Status.STATE_WAITING, 'no data yet')
            self.worker.chore(lambda: None, lambda *_: None)  # which gives the memory back
        response.success = True
        response.message = f'{count} messages are forgotten'
        return response

    async def _save_result(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        last = self.last
        if last is None or self.worker.busy:
            response.message = 'there is no result yet, or a run is in progress'
            return response
        directory = parameters.snapshot(self)['output_directory']
        done = Future(executor=self.executor)
        self.worker.chore(lambda: save(last, directory), lambda *end: done.set_result(end))
        path, error = await done
        response.success = error is None and bool(path)
        response.message = path or 'output_directory is empty; set it to a folder'
        if error is not None:
            response.message = self.board.fault(error).message
        else:
            self.pages.start(path)
        return response

    def _parameters_changed(self) -> None:
        """Hand on what is not read at the beginning of a run."""
        now = parameters.snapshot(self)
        self.capture.limit = now['buffer_messages']
        self.capture.keep_streams = now['keep_streams']
        self.capture.names = now['joint_names']
        self.diagnostics.missing_warning = now['missing_warning']

    # ------------------------------------------------------------------ the clock's rounds

    def _tick(self) -> None:
        if self.stopping:
            return
        self._ticks += 1
        for sentence in self.pages.failures():
            self.get_logger().error(sentence)
        capture = self.capture
        limit = self.get_parameter('end_of_stream').value
        if not capture.empty and not capture.ended:
            if capture.idle >= limit:
                self._stream_ended()
            elif not self.worker.busy and self.board.state != Status.STATE_RECORDING:
                self.board.change(Status.STATE_RECORDING, 'data arrives')
        if self._due and not self.worker.busy and capture.ended:
            self._identify_by_itself()
        if capture.empty and not self.worker.busy:
            self._explain()
        capture.adapt()
        if self._ticks % round(1.0 / TICK) == 0:
            capture.flush()
            if (not capture.empty and not capture.ended) or self.worker.busy:
                self.board.publish()
            self._publish_diagnostics()

    def _stream_ended(self) -> None:
        self.capture.end()
        self.get_logger().info(f'the stream has ended after {self.capture.received} messages')
        if self.worker.busy:
            self._due = True
            return
        self._identify_by_itself()

    def _identify_by_itself(self) -> None:
        self._due = False
        if not self.get_parameter('auto_start').value:
            self.board.change(
                Status.STATE_READY, 'the stream has ended; send a goal to ~/identify or ~/diagnose'
            )
            return
        try:
            self.identifying.begin(Identify.Goal(refine=self.get_parameter('refine').value))
        except Exception as error:
            fault = self.board.fault(error)
            self.board.change(Status.STATE_FAILED, fault.message, fault)

    def _explain(self) -> None:
        if time.monotonic() - self._explained < EXPLAIN:
            return
        self._explained = time.monotonic()
        if self.board.state == Status.STATE_WAITING:
            self.board.warn(self.capture.silence())

    def _publish_diagnostics(self) -> None:
        silence = self.capture.silence() if self.capture.empty and not self.worker.busy else ''
        self.diagnostics.state = self.board.sentence if self.worker.busy else 'no run in progress'
        now = self.get_clock().now().to_msg()
        self.outlet.diagnostics.publish(self.diagnostics.message(now, self.capture, silence))
