# SPDX-License-Identifier: Apache-2.0
"""The action ~/diagnose: from a goal to a run, and from its end to messages and files."""

from collections.abc import Callable
from typing import Any

from ros2_ident_msgs.action import Diagnose
from ros2_ident_msgs.msg import Gap, Status

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.jobs import Diagnosed
from ros2_ident.ros import parameters
from ros2_ident.ros.actions import GoalServer
from ros2_ident.ros.files import attempted, save
from ros2_ident.ros.gap_conversion import feedback_message, feedback_sentence, gap_message
from ros2_ident.ros.goals import diagnose_wanted
from ros2_ident.ros.run import diagnose, Finished

Says = Callable[[Any], None]


class Diagnoser:
    """Serves ~/diagnose with the node's worker, board and outlet.

    Args:
        node: The node, with the board, outlet, pages and worker that its runs share.

    Attributes:
        server: The action's server.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self.server = GoalServer(
            node,
            Diagnose,
            '~/diagnose',
            busy=node.occupation,
            begin=self._begin,
            cancel=node.worker.cancel,
            refuse=lambda error: node.board.refuse(error),
            failed=lambda error: self._message(None, node.board.fault(error)),
            field='gap',
            result_timeout=parameters.snapshot(node)['result_timeout'],
        )

    def _begin(self, goal: Any, tell: Says, done: Says) -> None:
        node = self._node
        now = parameters.snapshot(node)
        wanted = diagnose_wanted(goal, now, receiving=node.receiving, heard=node.heard)
        request = wanted.request
        buffer = None if request.bags else node.received()

        def job(cancel: Any, say: Says) -> tuple[Finished[Diagnosed], str, Exception | None]:
            found = diagnose(wanted, buffer, cancel, say)
            return found, *attempted(lambda: save(found))

        def said(progress: Any) -> None:
            feedback = feedback_message(progress)
            node.board.sentence = feedback_sentence(feedback)
            tell(feedback)

        def ended(value: Any, error: BaseException | None) -> None:
            try:
                message = self._ended(value, error)
            except Exception as failure:  # the result may be lost, but not the answer
                message = self._ended(None, failure)
            done(message)

        node.diagnostics.progress = None  # an earlier run's would pass for this one's
        source = ' + '.join(request.bags) or 'the data received'
        node.board.change(
            Status.STATE_DIAGNOSING, f'diagnosing {", ".join(request.drives or ())} from {source}'
        )
        node.worker.start(job, said, ended, rate=now['progress_rate'])

    def _message(
        self, found: Finished[Diagnosed] | None, error: IdentError | None, path: str = ''
    ) -> Gap:
        return gap_message(found, error, self._node.get_clock().now().to_msg(), path)

    def _ended(self, value: Any, error: BaseException | None) -> Gap:
        """Publish how a diagnosis ended; return the message."""
        node = self._node
        if error is not None:
            fault = node.board.fault(error)
            message = self._message(None, fault)
            node.board.change(Status.STATE_FAILED, fault.message, fault)
        else:
            found, path, unwritten = value
            node.last = found
            node.diagnostics.data = found.done.logs.fit
            message = self._message(found, None, path)
            fault = unwritten = unwritten and node.board.unwritten(unwritten)
            state, sentence = Status.STATE_DONE, found.done.result.sentence
            if found.cancelled:
                state = Status.STATE_CANCELLED
                sentence = f'The diagnosis was {message.error_message}. By then: {sentence}'
                fault = IdentError(ErrorCode.CANCELLED, message.error_message)
            node.board.change(state, sentence, fault)
            node.board.warnings(message.warnings)
            if unwritten is not None:
                message.warnings = [*message.warnings, unwritten.message]
            node.pages.start(path)
        node.diagnostics.gap = message
        node.outlet.gap.publish(message)
        return message
