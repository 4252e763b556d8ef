# SPDX-License-Identifier: Apache-2.0
"""Content of a bag: messages by topic, decoded piece by piece."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import cdr, maps
from ros2_ident.recording import definition as forms
from ros2_ident.recording.cdr import Block, ByteTable
from ros2_ident.recording.columns import TopicMap
from ros2_ident.recording.definition import Definition, standard, standard_of
from ros2_ident.recording.limits import limit, listed, printable, require_memory
from ros2_ident.recording.objects import Decode, decoder, FORMS
from ros2_ident.recording.storage import Budget, Damage, inflate, ZSTD
from ros2_ident.recording.streams import FloatArray, IntArray, LATEST_STAMP

# A trajectory is a few points; joint_trajectory_controller runs through them by a polynomial
# through all that two neighbouring points state (linear, cubic or quintic), from the last
# set-point on and until the next trajectory begins (ros2_controllers, trajectory.cpp).

# The set-point is sampled so often, ns.
PERIOD = 1_000_000
# Points closer than this stand at one time, s.
_CLOSE = 1e-9


@dataclass(frozen=True)
class Trajectory:
    """A trajectory for some joints."""

    start: int  # when it begins, ns; its arrival where the message does not say
    names: tuple[str, ...]  # the D joints
    time: FloatArray  # of its points (P,), s after the start, increasing
    # position, and velocity and acceleration where stated, (P, 1 to 3, D), in rad or m and s
    knots: FloatArray


def parse_trajectory(data: bytes, arrival: int, gaps: bool = True) -> Trajectory:
    """Read one serialised JointTrajectory.

    Args:
        data: The message; of ROS 2 with its four bytes of encapsulation.
        arrival: When it came, ns.
        gaps: Whether it is of ROS 2, as `Definition` has it.

    Raises:
        ValueError: The bytes are no JointTrajectory, or it can not be followed.
    """
    try:
        whole = data if gaps else bytes(standard().ros1_to_cdr(data, maps.TRAJECTORY))
        sent: Any = standard().deserialize_cdr(whole, maps.TRAJECTORY)
    except Exception as exc:  # generated code lets whatever damaged bytes cause through
        raise ValueError('no JointTrajectory') from exc
    names, stamp = tuple(sent.joint_names), sent.header.stamp
    if not sent.points or not names or len(set(names)) != len(names):
        raise ValueError('no points or joints')
    after = [x.time_from_start for x in sent.points]
    time = np.array([x.sec + 1e-9 * x.nanosec for x in after])
    stated = [(x.positions, x.velocities, x.accelerations) for x in sent.points]
    # as many derivatives as every point states, from the position on
    depth = min(next((k for k in range(3) if not x[k].size), 3) for x in stated)
    sizes = {row.size for x in stated for row in x[:depth]}
    if sizes != {len(names)}:
        said = ' and '.join(map(str, sorted(sizes))) or 'no'
        raise ValueError(f'{len(names)} names but positions of {said} joints')
    knots = np.array([x[:depth] for x in stated])
    if not np.isfinite(knots).all() or (np.diff(time) < _CLOSE).any() or time[0] < 0.0:
        raise ValueError('times of points that do not increase, or values that are no numbers')
    return Trajectory(stamp.sec * 1_000_000_000 + stamp.nanosec or arrival, names, time, knots)


def set_points(trajectories: Sequence[Trajectory]) -> list[Block]:
    """Return the set-point that a controller makes of trajectories, sampled evenly.

    Args:
        trajectories: In the order in which they came; those for the same joints replace each
            other from their start on.

    Returns:
        One block for each set of joints: stamps, positions (T, D) and velocities (T, D).

    Raises:
        IdentError: BAD_VALUES where it would take more memory than allowed.
    """
    blocks = []
    for names in dict.fromkeys(x.names for x in trajectories):
        own = [x for x in trajectories if x.names == names]
        last = max(x.start + round(1e9 * x.time[-1]) for x in own)
        first = own[0].start + round(1e9 * own[0].time[0])
        needed = 3 * (16 * len(names) * (last - first) // PERIOD)
        require_memory('the set-point of the trajectories takes', needed)
        stamp = np.arange(first, last + 1, PERIOD, dtype=np.int64)
        position = np.tile(own[0].knots[0, 0], (stamp.size, 1))
        velocity = np.zeros_like(position)
        for number, trajectory in enumerate(own):
            begin = int(np.searchsorted(stamp, trajectory.start)) if number else 0
            if begin < stamp.size:
                origin = position[begin - 1] if begin else None
                after = 1e-9 * (stamp[begin:] - trajectory.start)
                position[begin:], velocity[begin:] = _run_through(trajectory, origin, after)
        blocks.append(Block(np.arange(stamp.size), stamp, names, (position, velocity, None)))
    return blocks


def _run_through(
    trajectory: Trajectory, origin: FloatArray | None, after: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity (T, D) at times (T,) after a trajectory's start, s.

    From the set-point before, `origin` (D,), it goes to its first point; None to hold that.
    """
    time, knots = trajectory.time, trajectory.knots
    if origin is not None and time[0] > _CLOSE:
        time, knots = np.insert(time, 0, 0.0), np.insert(knots, 0, 0.0, axis=0)
        knots[0, 0] = origin
    held = np.clip(after, time[0], time[-1])
    if time.size == 1:
        return np.tile(knots[0, 0], (after.size, 1)), np.zeros((after.size, knots.shape[2]))
    path = scipy.interpolate.BPoly.from_derivatives(time, list(knots))
    moving = (held == after)[:, None]
    return path(held), np.where(moving, path.derivative()(held), 0.0)


# Bytes of messages that are decoded at once; fewer would take longer.
_HELD = 1 << 22
# Fewer messages show no rate of a clock; no clock is off by more, which a restart of a counter is.
_FEWEST, _SLOW = 20, 0.01
# Messages of a topic that is not read, which show what could be read there.
_SHOWN = 10


def why(kind: str, role: str) -> str:
    """Return what a message of a kind has to be."""
    if kind == maps.TRAJECTORY:
        return 'a value for each joint, and times that increase'
    if maps.nameless(kind, role):
        return 'it has to hold a number for each of the joint names given'
    return 'arrays have to be empty or as long as the names'


# Takes messages of a topic: log times, ns, and serialised bytes.
Sink = Callable[[Sequence[int], Sequence[bytes] | ByteTable], None]


@dataclass(eq=False)
class Messages:
    """The messages of a topic in the order of the file, decoded piece by piece.

    A message as an object takes some hundred bytes; hours of them at 1 kHz would fill the memory.
    """

    blocks_of: Decode  # makes blocks of messages
    # Of a counter, which counts from any instant, a line through it and the log times makes times
    # when all have come.
    clock: maps.Clock = 'stamp'
    padded: bool = False  # whether joints at the end that never show a value but 0 are none
    count: int = 0  # messages that came
    lost: int = 0  # those that are no valid ones of their type
    why: str = ''  # what is wrong with the last of these
    blocks: deque[Block] = field(default_factory=deque)  # log times for stamps that are not there
    unstamped: bool = False  # whether there are such
    # least and largest gain above 0, by its name and the number of the joint
    gains: dict[tuple[str, int], tuple[float, float]] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)  # what else is to be said of them
    _clocks: list[IntArray] = field(default_factory=list)
    _times: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _held: int = 0
    _bytes: int = 0

    def take(self, times: Sequence[int], data: Sequence[bytes] | ByteTable) -> None:
        """Take messages: log times [ns] and serialised bytes."""
        self.count += len(data)
        if isinstance(data, np.ndarray):
            self.decode()
            if not data[0].tobytes().startswith(ZSTD):
                return self._decode(times, data)
            data = [x.tobytes() for x in data]  # compressed one by one, by chance alike
        self._held += sum(map(len, data))
        self._times += times
        self._data += data
        if self._held > _HELD:
            self.decode()

    def decode(self) -> None:
        """Decode what has come since the last time; what is no such message is counted.

        Raises:
            IdentError: BAD_VALUES where the values take more memory than allowed.
        """
        times, data = self._times, self._data
        self._times, self._data, self._held = [], [], 0
        if any(x.startswith(ZSTD) for x in data[:_SHOWN]):  # compressed one by one
            budget = Budget(sum(map(len, data)))
            data = [_unpacked(x, budget) if x.startswith(ZSTD) else x for x in data]
        if data:
            self._decode(times, data)

    def _decode(self, times: Sequence[int], data: Sequence[bytes] | ByteTable) -> None:
        try:
            if max(times) >= LATEST_STAMP or min(times) <= -LATEST_STAMP:
                raise ValueError
            found = self.blocks_of(data)
        except (ValueError, IndexError):
            pairs = ((when, bytes(x)) for when, x in zip(times, data, strict=True))
            whole = [pair for pair in pairs if self._is_whole(*pair)]
            self.lost += len(data) - len(whole)
            times, found = [x for x, _ in whole], self.blocks_of([x for _, x in whole])
        clock = np.array(times, dtype=np.int64)
        for block in found:
            for name, values in zip(cdr.VALUES[3:], block.fields[3:], strict=False):
                if values is None:
                    continue
                ends = np.where(values > 0.0, values, np.nan)  # zero switches a joint off
                for joint in np.flatnonzero(np.isfinite(ends).any(axis=0)).tolist():
                    known = np.append(ends[:, joint], self.gains.get((name, joint), ()))
                    self.gains[name, joint] = np.nanmin(known), np.nanmax(known)
            block = replace(block, fields=block.fields[:3])
            self._bytes += sum(x.nbytes for x in block.fields if x is not None)
            if self.clock == 'counter':
                self._clocks.append(clock[block.rows])
            elif self.clock == 'none' or not block.stamp.any():
                block, self.unstamped = replace(block, stamp=clock[block.rows]), True
            self.blocks.append(block)
        # the builder needs them twice while it puts them together
        require_memory('the values of one topic take', 3 * self._bytes)

    def _is_whole(self, log_time: int, message: bytes) -> bool:
        try:
            (block,) = self.blocks_of([message])
        except (ValueError, IndexError) as exc:
            self.why = str(exc)
            return False
        names = block.names
        return bool(names) and len(set(names)) == len(names) and abs(log_time) < LATEST_STAMP

    def finish(self) -> None:
        """Decode the remaining messages into blocks."""
        self.decode()
        if self.clock == 'counter' and self.blocks:
            self._set_clock()
        if self.padded and self.blocks:
            self._trim()

    def _set_clock(self) -> None:
        """Make times of what was counted: the line that fits the log times best.

        Both clocks run evenly, and a message comes as late as another in the mean.
        """
        count, clock = np.concatenate([x.stamp for x in self.blocks]), np.concatenate(self._clocks)
        self._clocks = []
        x, y = count - count[0], clock - clock[0]
        off, mean = x - x.mean(), float(y.mean())
        rate = float(off @ y) / max(float(off @ off), 1e-300)
        stamp, said = clock, 'its counter does not run with the clock, the time of recording is '
        said += 'used, some milliseconds late'
        if count.size >= _FEWEST and abs(rate - 1.0) < _SLOW:
            shift = clock[0] + round(mean - rate * float(x.mean()))
            stamp = shift + x + np.round((rate - 1.0) * x).astype(np.int64)
            scatter = f'{1e-6 * float(np.std(clock - stamp)):.3g} ms of scatter'
            said = f'its counter is the time, set by the time of recording ({scatter})'
        self.said.append(said)
        ends = np.cumsum([x.stamp.size for x in self.blocks])[:-1]
        parts = zip(self.blocks, np.split(stamp, ends), strict=True)
        self.blocks = deque([replace(x, stamp=own) for x, own in parts])

    def _trim(self) -> None:
        """Leave out the joints at the end that show nothing but 0, and fields without a value."""
        used, there = 0, set()
        for block in self.blocks:
            for n, values in enumerate(block.fields):
                if values is not None:
                    rest = values[:, used:]
                    shows = np.flatnonzero(((rest != 0.0) & ~np.isnan(rest)).any(axis=0))
                    used += int(shows[-1]) + 1 if shows.size else 0
                    if n not in there and np.isfinite(values[:, :used]).any():
                        there.add(n)
        for _ in range(len(self.blocks)):
            x = self.blocks.popleft()
            pairs = ((n in there, y) for n, y in enumerate(x.fields))
            fields = tuple(y[:, :used] if own and y is not None else None for own, y in pairs)
            self.blocks.append(replace(x, names=x.names[:used], fields=fields))


@dataclass(eq=False)
class Trajectories(Messages):
    """The trajectories sent on a topic; their blocks are the set-point that follows them."""

    gaps: bool = True  # whether they are of ROS 2, as `Definition` has it
    sent: list[tuple[int, Trajectory]] = field(default_factory=list)

    def _decode(self, times: Sequence[int], data: Sequence[bytes] | ByteTable) -> None:
        for when, message in zip(times, map(bytes, data), strict=True):
            try:
                self.sent.append((when, parse_trajectory(message, when, self.gaps)))
            except ValueError:
                self.lost += 1

    def finish(self) -> None:
        """Follow the trajectories in the order in which they came."""
        self.decode()
        self.blocks += set_points([x for _, x in sorted(self.sent, key=lambda pair: pair[0])])
        self.sent = []


def messages_of(
    about: maps.MessageMap | None,
    role: str,
    names: Sequence[str] = (),
    drives: Sequence[str] = (),
    definition: Definition | None = None,
    form: str = '',
    schema: bytes = b'',
    stated: bool = False,
) -> Messages:
    """Return what decodes a role's messages, trajectories where nothing is said about fields.

    See `maps.parser`, and of `FORMS` `objects.decoder`.
    """
    if about is None:
        return Trajectories(lambda data: [], gaps=definition is None or definition.gaps)
    if form in FORMS:
        decode = decoder(about, role, form, schema)
    else:
        parse = maps.parser(about, role, names, drives, definition, stated)
        decode = partial(cdr.decode, parse=parse)
    return Messages(decode, about.clock, about.padded and not names)


def _unpacked(packed: bytes, budget: Budget) -> bytes:
    """Return a message; empty where it cannot be unpacked."""
    raw, sound = inflate('zstd', packed, budget.chunk)
    try:
        budget.take(len(raw))
    except Damage:
        return b''
    return raw if sound else b''


@dataclass
class Content:
    """Content of a bag."""

    wanted: Mapping[str, tuple[str, ...]]  # roles of each topic to read
    names: tuple[str, ...] = ()  # joints of messages that name none; see `maps.parser`
    drives: tuple[str, ...] = ()  # joints of the machine
    # topics that a column map names, which are read instead
    mapped: Mapping[str, TopicMap] = field(default_factory=dict)
    # names of the numbers of topics that have those on another
    titles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # by topic and role, of those wanted that can be read
    messages: dict[tuple[str, str], Messages] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)  # message type of every topic of the bag
    counts: dict[str, int] = field(default_factory=dict)  # messages of every topic of the bag
    warnings: list[str] = field(default_factory=list)  # what could not be read
    _first: dict[str, list[bytes]] = field(default_factory=dict)
    _schemas: dict[str, tuple[str, str, bytes]] = field(default_factory=dict)

    def open(self, topic: str, kind: str, form: str, schema: bytes) -> Sink | None:
        """Note a topic and its type; return where its messages go, None where they are unwanted.

        Args:
            form: Of the definition, as `definition_of` takes it, or of messages that are no CDR.
            schema: The definition of the type, empty where the file has none.

        Raises:
            Damage: There are more topics than any machine has.
        """
        if form == 'ros1msg' and '/msg/' not in kind:
            kind = kind.replace('/', '/msg/')
        if topic not in self.types:
            if len(self.types) >= 100 * limit('joints'):
                raise Damage('it names more topics than are allowed')
            self._schemas[topic] = kind, form, schema
            known = form in ('', *forms.OF_ROS) or (form in FORMS and maps.roles_of(kind))
            self.types[topic] = kind if known else f'{kind} ({form})'
        kind = self.types[topic]
        self.counts.setdefault(topic, 0)
        able = ('',) * (topic in self.mapped) if self.mapped else maps.roles_of(kind)
        own = maps.map_of(kind)
        if not able and (own is None or own.names_of is None):
            return None
        roles = able if self.mapped else [x for x in self.wanted.get(topic, ()) if x in able]
        if not roles:
            first = self._first.setdefault(topic, [])

            def show(times: Sequence[int], data: Sequence[bytes] | ByteTable) -> None:
                if len(first) < _SHOWN:
                    shown = map(bytes, data[:_SHOWN])
                    first.extend(x for x in shown if not x.startswith(ZSTD))

            return show
        for role in roles:
            if (topic, role) not in self.messages:
                made = self._messages_of(topic, role, self.names, self.drives)
                self.messages[topic, role] = made
        sinks = [self.messages[topic, role].take for role in roles]

        def fan(times: Sequence[int], data: Sequence[bytes] | ByteTable) -> None:
            for sink in sinks:
                sink(times, data)

        return fan

    def _messages_of(
        self, topic: str, role: str, names: Sequence[str] = (), drives: Sequence[str] = ()
    ) -> Messages:
        """Return what decodes a role's messages of a topic; see `messages_of`."""
        kind, form, schema = self._schemas[topic]
        about = self._mapped(topic) if self.mapped else maps.map_of(kind)
        known = None if self.mapped else self.definition(topic)
        titles = () if names else self.titles.get(topic, ())
        of = (names or titles, drives, known, form, schema, bool(titles))
        return messages_of(about, role, *of)

    def _mapped(self, topic: str) -> maps.MessageMap:
        """Return the meaning of the fields of a topic that a column map names."""
        about, (kind, form, _) = self.mapped[topic], self._schemas[topic]
        known, own = None, maps.map_of(kind)
        if form not in FORMS:
            known = self.definition(topic) or standard_of(self.types[topic])
            known = known or (own.definition if own else None)
            if known is None:
                text = f'{topic}: the file holds no definition of {printable(kind)}; record it '
                raise ErrorCode.MISSING_STREAM.error(f'{text}as MCAP, which keeps definitions')
        columns = [(str(x.cell), x.entry, x.of) for x in about.columns]
        try:
            return maps.map_of_fields(kind, columns, about.time, about.digits, known)
        except LookupError as exc:
            text = f'{topic}: {printable(kind)} has no field {printable(str(exc.args[0]))}'
            there = listed(known.numbers(40) if known else [], 30)
            text += f', its numbers are {there}; correct the column map'
            raise ErrorCode.MISSING_STREAM.error(text) from None

    def definition(self, topic: str) -> Definition | None:
        """Return a topic's message definition, None where the file has none that can be read."""
        return forms.definition_of(self.types[topic], *self._schemas[topic][1:])

    def has_shown(self, counts: Mapping[str, int]) -> bool:
        """Say whether nothing is read, and each topic has shown as many messages as it may."""
        pairs = ((len(x), counts.get(topic, 0)) for topic, x in self._first.items())
        return not self.messages and all(there >= min(_SHOWN, count) for there, count in pairs)

    def offered(self) -> Iterator[tuple[str, str, tuple[str, ...]]]:
        """Yield topic, type and possible roles of what could be read and is not wanted."""
        for topic in sorted(self._first):
            kind = self.types[topic]
            if able := maps.roles_of(kind):
                shown = [x for x in able if kind == maps.TRAJECTORY or self._shows(topic, x)]
                yield topic, kind, tuple(shown)

    def titled(self) -> dict[str, tuple[str, ...]]:
        """Return the names of numbers, by their topic, that another topic beside it has."""
        found = {}
        for topic, first in self._first.items():
            about = maps.map_of(self.types[topic])
            if about is None or about.names_of is None or not first:
                continue
            beside, path = about.names_of
            known = self.definition(topic) or about.definition
            assert known is not None
            with suppress(ValueError, IdentError):
                names = forms.found_at(forms.walker(known, [path])(first[0])[0], path)
                found[f'{topic.rpartition("/")[0]}/{beside}'] = tuple(map(str, names))
        return found

    def joints_of(self, topic: str, role: str) -> set[str]:
        """Return the joints that the first messages of a topic name in a role."""
        messages = self._messages_of(topic, role)
        messages.take([0] * len(self._first[topic]), self._first[topic])
        messages.finish()
        return {name for block in messages.blocks for name in block.names}

    def _shows(self, topic: str, role: str) -> bool:
        """Say whether a message of a topic holds values of a role without being told anything."""
        messages = self._messages_of(topic, role)
        for data in self._first[topic]:
            with suppress(ValueError, IndexError, IdentError):
                (block,) = messages.blocks_of([data])
                position, velocity, effort = (x is not None for x in block.fields[:3])
                if block.names and (effort if role == 'effort' else position or velocity):
                    return True
        return False
