# SPDX-License-Identifier: Apache-2.0
"""The actions ~/identify, ~/diagnose and ~/diff: from a goal to a run, then to messages and files.

Long goals on one thread: the callback awaits a future while the worker does the work. A callback
that blocked would keep the executor from answering a cancel. This one is a coroutine: it gives the
executor back at once and goes on when the run has ended.
"""

from collections.abc import Callable
from typing import Any, Literal

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.qos import qos_profile_parameters
from rclpy.task import Future
from ros2_ident_msgs.action import Diagnose, Diff, Identify
from ros2_ident_msgs.msg import Status

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.jobs import Identified
from ros2_ident.ros import conversion, parameters, run
from ros2_ident.ros.diagnostics import excitation
from ros2_ident.ros.goals import wanted_of
from ros2_ident.ros.worker import attempt
from ros2_ident.search.evaluators import Cancel

Says = Callable[[Any], None]

# Requests wait here for the executor. Of the ten that services hold by default an eleventh would
# push out the first, without an answer; this is what ROS gives a node's parameters (1000).
REQUESTS = qos_profile_parameters
# How a run has ended, by the code of its message; with any other it has failed.
_STATES = {ErrorCode.OK: Status.STATE_DONE, ErrorCode.CANCELLED: Status.STATE_CANCELLED}


class GoalServer:
    """An action of which one goal runs at a time, beside whatever else keeps the node busy.

    Attributes:
        pending: Whether a goal has been accepted that has not begun yet.
        open: How many accepted goals have no result yet.
    """

    # The action, its name and what `run.carry_out` does.
    action: Any
    what: Literal['identify', 'diagnose', 'diff']
    # What the node does meanwhile, and its state.
    doing: str
    state: int
    # Field of the result that holds the message of a run's end, and the latched topic it goes to.
    field: str
    topic: str

    # Makes a progress a feedback and a sentence, and the end of a run that message.
    feedback: Callable[..., tuple[Any, str]]
    message: Callable[..., Any]

    @staticmethod
    def sentence(message: Any) -> str:
        """Return what was found."""
        return str(message.outcome_sentence)

    def __init__(self, node: Any) -> None:
        self.node = node
        self.pending = False
        self.open = 0
        self._finish: Says | None = None
        self._given_up = False
        self._server = ActionServer(
            node,
            self.action,
            f'~/{self.what}',
            self._execute,
            goal_callback=self._answer,
            cancel_callback=self._answer_cancel,
            goal_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
            result_timeout=round(parameters.snapshot(node)['result_timeout']),
        )

    # ------------------------------------------------------------------ the goal and its client

    def _answer(self, goal: Any) -> GoalResponse:
        """Accept a goal unless something runs; what is wrong with it is said in its result."""
        error = self._occupied()
        if error is not None:
            self.node.board.refuse(error)
            return GoalResponse.REJECT
        self.pending = True
        self.open += 1
        return GoalResponse.ACCEPT

    def _occupied(self) -> IdentError | None:
        running = self.node.occupation()
        if not running:
            return None
        return ErrorCode.BUSY.error(
            f'a goal was refused: {running} is in progress; wait for its end or cancel it'
        )

    def _answer_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        if self._finish is not None:  # or another run than this goal's would end
            self.node.worker.cancel()
        return CancelResponse.ACCEPT

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        try:
            message = await self._message_of(handle)
            code = message.error_code
            # A run that ended before it saw the cancel has its whole result: it succeeded.
            if handle.is_cancel_requested and code != ErrorCode.OK:
                handle.canceled()
            elif code == ErrorCode.OK and not self._given_up:
                handle.succeed()
            else:
                # The end of the node stops a run, too, but no client has asked for it.
                handle.abort()
            return self.action.Result(**{self.field: message})
        finally:
            self.open -= 1

    async def _message_of(self, handle: ServerGoalHandle) -> Any:
        """Run a goal; return its result's message, whatever happens."""
        self.pending = False
        done = Future(executor=self.node.executor)

        def finish(message: Any) -> None:
            self._finish = None
            if done.done():  # given up
                return
            done.set_result(message)
            # a future that is set outside of the executor's round would wait for the next event
            executor = self.node.executor
            if executor is not None:
                executor.wake()

        def tell(progress: Any) -> None:
            if handle.is_active:
                handle.publish_feedback(progress)

        try:
            # a run may have started by itself since the goal was accepted
            if (error := self._occupied()) is not None:
                raise error
            self.begin(handle.request, tell, finish)
        except IdentError as error:
            self.node.board.refuse(error)
            return self._message(None, error)
        except Exception as error:  # whatever it is, the client hears of it
            return self._message(None, self.node.board.fault(error))
        self._finish = finish
        if handle.is_cancel_requested:  # taken together with the goal
            self.node.worker.cancel()
        return await done

    def give_up(self, error: IdentError) -> None:
        """Answer the goal that runs, without waiting for the end of its run any longer."""
        if self._finish is not None:
            self._given_up = True
            self._finish(self._message(None, error))

    # ------------------------------------------------------------------ the run

    def begin(
        self, goal: Any, tell: Says = lambda feedback: None, done: Says = lambda message: None
    ) -> None:
        """Start a run.

        Raises:
            IdentError: Where the goal is unusable; nothing has been started then.
        """
        node = self.node
        now = parameters.snapshot(node)
        heard, states = node.description, node.states
        wanted = wanted_of(goal, now, receiving=node.receiving, heard=heard, states=states)
        received = node.received() if wanted.live else None

        def preview(*streams: Any) -> None:
            series = [run.messages(x) for x in streams]
            node.worker.post(lambda: node.outlet.series(*series))

        def job(cancel: Cancel, say: Says) -> tuple[Any, ...]:
            done = run.carry_out(self.what, wanted, received, cancel, say, preview)
            # a result is not lost with its file
            return done, excitation(done.logs.fit), *attempt(lambda: run.save(done))

        def said(progress: Any) -> None:
            feedback, node.board.sentence = self.feedback(progress, wanted.machine, self._stamp)
            if self.what == 'identify':
                node.diagnostics.progress = feedback.progress
                node.outlet.progress.publish(feedback.progress)
            tell(feedback)

        def ended(value: Any, error: BaseException | None) -> None:
            try:
                message = self._ended(value, error)
            except Exception as failure:  # the result may be lost, but not the answer
                message = self._ended(None, failure)
            done(message)

        node.diagnostics.progress = None  # an earlier run's would pass for this one's
        source = ' + '.join(wanted.bags) or 'the data received'
        what = f'{self.doing} {", ".join(wanted.drives or ())} from {source}'
        node.board.change(self.state, what)
        node.worker.start(job, said, ended, rate=now['progress_rate'])

    def _ended(self, value: Any, error: BaseException | None) -> Any:
        """Publish how a run ended; return the message."""
        node = self.node
        if error is not None:
            fault = node.board.fault(error)
            message = self._message(None, fault)
            state = _STATES.get(fault.code, Status.STATE_FAILED)
            node.board.change(state, fault.message, fault)
        else:
            found, moved, path, unwritten = value
            path = path or ''
            node.last = found
            node.diagnostics.excitation = moved
            message = self._message(found, None, path)
            if isinstance(found, Identified):
                self._compare(found, path)
            code = ErrorCode(message.error_code)
            fault = code.error(message.error_message) if code else None
            unwritten = unwritten and node.board.unwritten(unwritten)
            state = _STATES.get(code, Status.STATE_FAILED)
            node.board.change(state, self.sentence(message), fault or unwritten)
            for sentence in message.warnings:
                node.get_logger().warning(sentence)
            if unwritten is not None:
                message.warnings = [*message.warnings, unwritten.message]
            node.pages.start(path)
        setattr(node.diagnostics, self.topic, message)
        getattr(node.outlet, self.topic).publish(message)
        return message

    def _compare(self, found: Identified, path: str) -> None:
        """Publish and write the simulated machine beside the measured one, after the result."""
        node = self.node

        def done(value: Any, error: BaseException | None) -> None:
            if error is not None:
                node.get_logger().error(node.board.fault(error).message)
                return
            *series, scene = value
            node.outlet.series(*series)
            if scene is not None:
                node.outlet.scene.publish(scene)

        if not node.stopping:  # a run that the node's end has cut
            node.worker.chore(lambda: run.compare(found, path), done)

    def _message(self, found: Any, error: IdentError | None, path: str = '') -> Any:
        return self.message(found, error, self._stamp, path)

    @property
    def _stamp(self) -> Any:
        return self.node.get_clock().now().to_msg()


class IdentifyServer(GoalServer):
    """The action ~/identify."""

    action, what, doing, state = Identify, 'identify', 'identifying', Status.STATE_IDENTIFYING
    field, topic = 'identification', 'result'
    feedback = staticmethod(conversion.identify_feedback)
    message = staticmethod(conversion.result_message)


class DiagnoseServer(GoalServer):
    """The action ~/diagnose."""

    action, what, doing, state = Diagnose, 'diagnose', 'diagnosing', Status.STATE_DIAGNOSING
    field, topic = 'gap', 'gap'
    feedback = staticmethod(conversion.diagnose_feedback)
    message = staticmethod(conversion.gap_message)
    sentence = staticmethod(conversion.gap_sentence)


class DiffServer(GoalServer):
    """The action ~/diff."""

    action, what, doing, state = Diff, 'diff', 'comparing', Status.STATE_COMPARING
    field, topic = 'comparison', 'comparison'
    feedback = staticmethod(conversion.diff_feedback)
    message = staticmethod(conversion.comparison_message)

    @staticmethod
    def sentence(message: Any) -> str:
        """Return what was found."""
        return str(message.sentence or message.error_message)
