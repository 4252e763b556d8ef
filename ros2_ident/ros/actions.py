# SPDX-License-Identifier: Apache-2.0
"""Long goals on one thread: the callback awaits a future while the worker does the work.

A callback that blocked would keep the executor from answering a cancel. This one is a coroutine:
it gives the executor back at once and goes on when the run has ended.
"""

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import qos_profile_parameters
from rclpy.task import Future

from ros2_ident.errors import ErrorCode, IdentError

Done = Callable[[Any], None]

# Requests wait here for the executor. Of the ten that services hold by default an eleventh would
# push out the first, without an answer; this is what ROS gives a node's parameters (1000).
REQUESTS = qos_profile_parameters


class GoalServer:
    """An action of which one goal runs at a time, beside whatever else keeps the node busy.

    Args:
        node: The node.
        kind: Type of the action.
        name: Its name.
        busy: Returns what runs now as words for a sentence, empty for nothing.
        begin: Starts a goal: gets it, what to call with each feedback, and what to call with
            the result message at the end. Raises IdentError where the goal is unusable.
        cancel: Asks the run to end with the best so far.
        refuse: Is told why a goal was refused.
        failed: Makes a result message of what was raised.
        field: Name of the result's field, which holds a message with an error code.
        result_timeout: How long a result can be asked for after the end, s.

    Attributes:
        pending: Whether a goal has been accepted that has not begun yet.
        open: How many accepted goals have no result yet.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        *,
        busy: Callable[[], str],
        begin: Callable[[Any, Done, Done], None],
        cancel: Callable[[], None],
        refuse: Callable[[IdentError], None],
        failed: Callable[[BaseException], Any],
        field: str,
        result_timeout: float,
    ) -> None:
        self._node = node
        self._kind = kind
        self._busy = busy
        self._begin = begin
        self._cancel = cancel
        self._refuse = refuse
        self._failed = failed
        self._field = field
        self.pending = False
        self.open = 0
        self._finish: Done | None = None
        self._given_up = False
        self._server = ActionServer(
            node,
            kind,
            name,
            self._execute,
            goal_callback=self._answer,
            cancel_callback=self._answer_cancel,
            goal_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
            result_timeout=round(result_timeout),
        )

    def _answer(self, goal: Any) -> GoalResponse:
        """Accept a goal unless something runs; what is wrong with it is said in its result."""
        error = self._occupied()
        if error is not None:
            self._refuse(error)
            return GoalResponse.REJECT
        self.pending = True
        self.open += 1
        return GoalResponse.ACCEPT

    def _occupied(self) -> IdentError | None:
        running = self._busy()
        if not running:
            return None
        return IdentError(
            ErrorCode.BUSY,
            f'a goal was refused: {running} is in progress; wait for its end or cancel it',
        )

    def _answer_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        if self._finish is not None:  # or another run than this goal's would end
            self._cancel()
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
            return self._kind.Result(**{self._field: message})
        finally:
            self.open -= 1

    async def _message_of(self, handle: ServerGoalHandle) -> Any:
        """Run a goal; return its result's message, whatever happens."""
        self.pending = False
        done = Future(executor=self._node.executor)

        def finish(message: Any) -> None:
            self._finish = None
            if done.done():  # given up
                return
            done.set_result(message)
            # a future that is set outside of the executor's round would wait for the next event
            executor = self._node.executor
            if executor is not None:
                executor.wake()

        def tell(progress: Any) -> None:
            if handle.is_active:
                handle.publish_feedback(progress)

        try:
            # a run may have started by itself since the goal was accepted
            if (error := self._occupied()) is not None:
                raise error
            self._begin(handle.request, tell, finish)
        except IdentError as error:
            self._refuse(error)
            return self._failed(error)
        except Exception as error:  # whatever it is, the client hears of it
            return self._failed(error)
        self._finish = finish
        if handle.is_cancel_requested:  # taken together with the goal
            self._cancel()
        return await done

    def give_up(self, error: IdentError) -> None:
        """Answer the goal that runs, without waiting for the end of its run any longer."""
        if self._finish is not None:
            self._given_up = True
            self._finish(self._failed(error))
