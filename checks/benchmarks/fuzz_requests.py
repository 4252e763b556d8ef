# SPDX-License-Identifier: Apache-2.0
"""Machine files, descriptions, messages and goals by the hundred thousand: what is made of them.

Machine files from `config/` are damaged in their bytes, or one of their values is replaced by an
odd one; so are a URDF and an MJCF, whose elements are also repeated, nested and put elsewhere;
JointState messages are damaged and given to what the node feeds them to; goals get odd values in
one to four fields; files of results are damaged or get an odd value before page, tables or
estimate are made of them; a checkpoint's records get odd values under valid checksums before a run
goes on from it; column maps and the metadata of LeRobot folders are damaged or get odd values
before their logs are read. Each has to be taken, or refused in one printable sentence with a code,
within ten seconds of CPU time and 2 GiB. Whatever else is raised is printed.

Example: python checks/benchmarks/fuzz_requests.py --machines 200000 --messages 100000 --goals 1000
"""

import argparse
from collections import Counter
from collections.abc import Callable
import copy
from functools import partial
import json
from pathlib import Path
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
from typing import Any
import warnings

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parents[2] / 'test'))

from identify_cases import axis, axis_data  # noqa: E402
from reader_cases import COLUMNS, damage, make_recording, raw_messages, table_text  # noqa: E402
from report_cases import write_diagnosed, write_identified  # noqa: E402

from ros2_ident.cli.main import main as ident  # noqa: E402
from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.identify.run import identify  # noqa: E402
from ros2_ident.identify.settings import IdentifySettings  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402
from ros2_ident.models.registry import kind_of, read_machine_file  # noqa: E402
from ros2_ident.recording import read_bag, RecordingBuilder, Topics  # noqa: E402
from ros2_ident.recording.cdr import decode, JOINT_STATE  # noqa: E402
from ros2_ident.recording.maps import map_of, parser  # noqa: E402
from ros2_ident.report.estimate import read_estimate  # noqa: E402
from ros2_ident.report.page import write_comparison, write_report  # noqa: E402
from ros2_ident.search import GeneticSettings, journal  # noqa: E402

ROOT = Path(__file__).parents[2]
ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 1e-300, -1e300, 1e308, 10**400, 1 << 63, 0.1),
    *(float('nan'), float('inf'), -float('inf'), '', ' ', 'x', 'nan', '1e3', '\x1b[31m', '\0'),
    *('drive_1', 'emps_axis', 'é' * 300, '../..', '/dev/null', '/dev/stdin', '~', '~nobody/x'),
    *([], {}, [1.0], [1.0, 'x'], [[]], {'a': 1}, ['drive_1'] * 3, [0.0] * 1000),
)


class Slow(Exception):
    """An input took too long."""


def too_long(*_: object) -> None:
    """End it."""
    raise Slow


def swapped(value: Any, generator: random.Random) -> Any:
    """Return nested plain data with one value, somewhere, replaced by an odd one."""
    places: list[tuple[Any, Any]] = []

    def walk(here: Any) -> None:
        for key in here if isinstance(here, dict) else range(len(here)):
            places.append((here, key))
            if isinstance(here[key], (dict, list)):
                walk(here[key])

    out = copy.deepcopy(value)
    walk(out)
    where, key = generator.choice(places)
    how = generator.random()
    if how < 0.15:
        del where[key]
    elif how < 0.3 and isinstance(where, dict):
        where[generator.choice(('x', 1, None, 'kind', '\x1b'))] = where.pop(key)
    else:
        where[key] = generator.choice(ODD)
    return out


class Machines:
    """Damaged machine files."""

    def __init__(self, room: Path) -> None:
        self.path = room / 'machine.yaml'
        files = ('emps', 'tripod', 'belt_drive', 'xl330')
        self.texts = [(ROOT / 'config' / f'{x}.yaml').read_bytes() for x in files]
        self.plain = [yaml.safe_load(x) for x in self.texts]

    def __call__(self, generator: random.Random) -> str:
        """Read one."""
        if generator.random() < 0.4:
            data = damage(generator.choice(self.texts), generator)
        else:
            plain = swapped(generator.choice(self.plain), generator)
            if generator.random() < 0.3:
                plain = swapped(plain, generator) if plain else plain
            data = yaml.safe_dump(plain, allow_unicode=True).encode()
        self.path.write_bytes(data)
        if generator.random() < 0.2:
            read_machine_file(self.path)
        load_machine(self.path)
        return 'taken'


MJCF = """<mujoco><option timestep="0.001"/><compiler angle="radian" autolimits="true"/>
<default><joint damping="0.1"/></default><worldbody><geom type="plane" size="1 1 1"/>
<body name="upper"><joint name="one" axis="0 1 0" range="-1 1"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.001"/>
<body name="lower" pos="0 0 -0.2"><joint name="two" type="slide" axis="0 1 0"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.1" density="900"/></body></body></worldbody>
<actuator><position joint="one" kp="20"/><motor joint="two"/></actuator>
<equality><joint joint1="one" joint2="two"/></equality><size memory="1M"/></mujoco>"""
PARTS = (
    *('<include file="/dev/null"/>', '<mesh file="/dev/stdin"/>', '<x:y/>', '<!--'),
    '<![CDATA[<]]>',
    *('<replicate count="300000"><geom size="1"/></replicate>', '&#0;', '&e;', '\ufeff'),
    *('<hfield name="h" nrow="12000" ncol="12000" size="1 1 1 1"/>', '<mimic joint="one"/>'),
    *('<?xml version="1.0" encoding="utf-7"?>', '<!DOCTYPE r [<!ENTITY e "9">]>', '\ud800'),
    *('<key qpos="nan"/>', '<composite type="cable" count="1001 1 1"/>', '<freejoint/>'),
    *('<attach model="m"/>', '<inertial/>', '<link/>', '<joint/>', '<numeric size="-1"/>'),
    '<body><joint type="ball"/></body>',
)


class Urdf:
    """Descriptions of an arm."""

    text = (ROOT / 'config' / 'kr300.urdf').read_text()

    def __init__(self, room: Path) -> None:
        self.path, self.machine = room / 'robot.xml', room / 'machine.yaml'
        plain = yaml.safe_load((ROOT / 'config' / 'kr300.yaml').read_text())
        plain['geometry']['description'] = 'robot.xml'
        self.write(plain)

    def write(self, plain: dict[str, Any]) -> None:
        """Write the machine file."""
        self.machine.write_text(yaml.safe_dump(plain))

    def __call__(self, generator: random.Random) -> str:
        """Read one as `ident check` and a model do."""
        text = self.text
        for _ in range(generator.choice((1, 1, 2, 4))):
            text = changed(text, generator)
        data = text.encode(generator.choice(('utf-8',) * 40 + ('utf-16',)), 'surrogatepass')
        if generator.random() < 0.1:
            data = damage(data, generator)
        self.path.write_bytes(data)
        machine = load_machine(self.machine)
        read = kind_of(machine).read
        assert read is not None
        read(machine)
        return 'taken'


class Mjcf(Urdf):
    """Descriptions of an arm, of the other format."""

    text = MJCF
    kind = 'serial'

    def write(self, plain: dict[str, Any]) -> None:
        """Write the machine file."""
        boxes = {'serial': {'link_mass': [-1, 1, 'kg']}, 'mujoco': {'kp': [1, 9, 'N m/rad']}}
        content = {'machine': self.kind, 'drives': ['one', 'two'], 'parameters': boxes[self.kind]}
        geometry = {'geometry': {'description': 'robot.xml'}, 'controller': {'cycle': 0.002}}
        super().write(content | geometry)


class Simulators(Mjcf):
    """Descriptions of a simulator."""

    kind = 'mujoco'


def changed(text: str, generator: random.Random) -> str:
    """Return a description's text with one change."""
    how = generator.random()
    pattern = r'[\w]="([^"]*)"' if how < 0.5 else r'<(\w+)[^<>]{0,300}>' if how < 0.85 else r'()<'
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    place = generator.choice(found)
    count = generator.choice((0, 2, 2, 300, 1_001))
    if how < 0.5:
        odd = [*map(str, ODD), '1 2', '1e9', '-5 1 1', 'x' * 257, generator.choice(found)[1]]
        return text[: place.start(1)] + str(generator.choice(odd)) + text[place.end(1) :]
    if how < 0.7:
        return text[: place.start()] + place[0] * count + text[place.end() :]
    if how < 0.85:
        nested = place[0].replace('/>', '>') * count + f'</{place[1]}>' * count
        return text[: place.start()] + nested + text[place.start() :]
    return text[: place.start()] + generator.choice(PARTS) + text[place.start() :]


def written(path: Path, text: str, generator: random.Random) -> None:
    """Write JSON or YAML with damaged bytes, or with an odd value or two."""
    if generator.random() < 0.4:
        path.write_bytes(damage(text.encode(), generator))
        return
    plain = swapped(yaml.safe_load(text), generator)
    if plain and generator.random() < 0.3:
        plain = swapped(plain, generator)
    dump = json.dumps if path.suffix == '.json' else partial(yaml.safe_dump, allow_unicode=True)
    path.write_text(dump(plain))


class Columns:
    """Damaged column maps."""

    def __init__(self, room: Path) -> None:
        self.path = room / 'a.csv'
        self.path.write_text(table_text(make_recording(24)))
        options = '{skip: 0, skip_below: 0, header: true, delimiter: ",", decimal: ".", where: {}}'
        self.texts = COLUMNS, yaml.safe_dump(yaml.safe_load(COLUMNS) | yaml.safe_load(options))

    def __call__(self, generator: random.Random) -> str:
        """Read a table by one."""
        text = generator.choice(self.texts)
        written(self.path.with_name('a.columns.yaml'), text, generator)
        read_bag(self.path)
        return 'taken'


class Lerobot:
    """Damaged metadata of LeRobot folders, and calibrations."""

    def __init__(self, room: Path) -> None:
        import pyarrow
        from pyarrow import parquet

        self.room, self.calibration = room / 'log', room / 'so101.json'
        (self.room / 'meta').mkdir(parents=True)
        (self.room / 'data/chunk-000').mkdir(parents=True)
        features = 'observation.state', 'observation.effort', 'action'
        count = np.arange(24)
        columns = {x: [[0.1 * n] for n in count] for x in features}
        table = pyarrow.table({**columns, 'frame_index': count, 'episode_index': 0 * count})
        parquet.write_table(table, self.room / 'data/chunk-000/file-000.parquet')
        about = {'dtype': 'float32', 'shape': [1], 'names': ['pan.pos']}
        info = {'codebase_version': 'v3.0', 'fps': 30, 'features': dict.fromkeys(features, about)}
        motor = {'pan': {'id': 1, 'range_min': 1500, 'range_max': 2524}}
        self.texts = json.dumps(info), json.dumps(motor)

    def __call__(self, generator: random.Random) -> str:
        """Read a folder."""
        info = self.room / 'meta' / 'info.json'
        for path, text in zip((info, self.calibration), self.texts, strict=True):
            path.write_text(text)
        which = int(generator.random() < 0.3)
        written((info, self.calibration)[which], self.texts[which], generator)
        unit = 'percent' if which else generator.choice(('rad', 'deg', ''))
        read_bag(self.room, Topics(columns=str(self.calibration), position_unit=unit))
        return 'taken'


class Messages:
    """Damaged JointState messages, a hundred to a recording."""

    def __init__(self, room: Path) -> None:
        self.whole = [data for _, _, data in raw_messages(make_recording(24))]
        self.builder = RecordingBuilder()
        self.fed = 0

    def __call__(self, generator: random.Random) -> str:
        """Feed one as the node does, and build after a hundred."""
        data = generator.choice(self.whole)
        if generator.random() < 0.8:
            data = damage(data, generator)
        role = generator.choice(('state', 'effort', 'command'))
        try:
            for block in decode([data], parser(map_of(JOINT_STATE), 'state')):
                self.builder.add_block(role, block.stamp, block.names, *block.fields)
        except (ValueError, IndexError):
            return 'refused'
        self.fed += 1
        if self.fed % 100 == 0:
            built, self.builder = self.builder, RecordingBuilder()
            built.build()
        return 'taken'


class Goals:
    """Goals with odd values."""

    def __init__(self, room: Path) -> None:
        from ros2_ident_msgs.action import Diagnose, Diff, Identify

        from ros2_ident.ros.goals import wanted_of
        from ros2_ident.ros.parameters import BY_NAME

        self.ask = wanted_of
        self.kinds = Identify.Goal, Diagnose.Goal, Diff.Goal
        values: dict[str, Any] = {name: entry.default for name, entry in BY_NAME.items()}
        values |= {'machine_file': str(ROOT / 'config' / 'emps.yaml'), 'drives': []}
        self.parameters = [values, values | {'allowed_directory': str(room)}]
        paths = (str(ROOT / 'bags' / 'axis_reversals'), str(room), '/proc/self/mem', '/')
        self.words = (*paths, 'viscous_friction', 'backlash', 'effort', 'linear_axis')

    def __call__(self, generator: random.Random) -> str:
        """Ask for one."""
        goal = generator.choice(self.kinds)()
        fields = goal.get_fields_and_field_types()
        for name in generator.sample(list(fields), generator.randrange(1, 5)):
            setattr(goal, name, self.value(fields[name], generator))
        self.ask(goal, generator.choice(self.parameters))
        return 'taken'

    def value(self, kind: str, generator: random.Random) -> Any:
        """Return an odd value of a type, or one that is close to a good one."""
        if kind.startswith('sequence'):
            inner = kind[len('sequence<') : -1]
            return [self.value(inner, generator) for _ in range(generator.choice((0, 1, 2, 50)))]
        if kind == 'boolean':
            return generator.random() < 0.5
        if kind == 'string':
            return generator.choice((*(x for x in ODD if isinstance(x, str)), *self.words))
        if kind in ('double', 'float'):
            odd = [float(x) for x in ODD if isinstance(x, float)]
            return generator.choice((*odd, 0.0, 1.0, 1e9, -1e-9, 0.5))
        most = (1 << int(kind.removeprefix('uint'))) - 1
        return generator.choice((0, 1, 2, 10, most // 2, most))


class Results:
    """Damaged files of an identification and a diagnosis, and of a comparison of two logs."""

    def __init__(self, room: Path) -> None:
        self.room, change = room / 'run', room / 'change'
        write_identified(self.room)
        write_diagnosed(self.room)
        bag = str(ROOT / 'bags' / 'axis_reversals')
        made = ['diff', bag, '--after', bag, '--machine', str(ROOT / 'config' / 'emps.yaml')]
        ident([*made, '--out', str(change), '--quiet'])
        rooms = sorted(self.room.iterdir()), [change / 'change.json']
        self.whole = {path: path.read_bytes() for paths in rooms for path in paths}

    def __call__(self, generator: random.Random) -> str:
        """Make page or estimate."""
        for path, data in self.whole.items():
            path.write_bytes(data)
        path = generator.choice([*self.whole, *(x for x in self.whole if x.suffix == '.json')])
        if path.suffix == '.json' and generator.random() < 0.8:
            path.write_text(json.dumps(swapped(json.loads(self.whole[path]), generator)))
        else:
            path.write_bytes(damage(self.whole[path], generator))
        readers = write_report, read_estimate, lambda room: write_comparison([room, room])
        generator.choice(readers)(path.parent)
        return 'taken'


class Checkpoints:
    """Records with odd values, whole by their checksums."""

    def __init__(self, room: Path) -> None:
        self.path = room / 'run.checkpoint'
        small = GeneticSettings(initial_population=16, survivors=2, children=4, generations=3)
        self.settings = IdentifySettings(genetic=small)
        self.key = f'{problem_of(axis(), axis_data()).key} 0 {small}'
        self.records: list[tuple[Any, ...]] = []
        put = journal.Journal.put
        journal.Journal.put = lambda _, *what: self.records.append(what)  # type: ignore
        self.whole = self.identified()
        journal.Journal.put = put  # type: ignore[method-assign]

    def identified(self) -> Any:
        """Identify."""
        return identify(axis(), axis_data(), settings=self.settings, checkpoint=self.path)

    def __call__(self, generator: random.Random) -> str:
        """Write a checkpoint of odd records, and go on from it."""
        self.path.unlink(missing_ok=True)
        with journal.Journal(self.path, self.key) as kept:
            for values, *what in self.records:
                kept.put({x: self.odd(y, generator) for x, y in values.items()}, *what)
        if generator.random() < 0.2:
            self.path.write_bytes(damage(self.path.read_bytes(), generator))
        cost = self.identified().cost.refined
        assert np.isclose(cost, self.whole.cost.refined, rtol=1e-3), cost
        return 'taken'

    def odd(self, value: Any, generator: random.Random) -> Any:
        """Return a value, or often an odd one."""
        if generator.random() < 0.7:
            return value
        factor = generator.choice((0.5, -1.0, 1e300, float('nan'), 1.001))
        with np.errstate(all='ignore'):
            shaken = np.asarray(value, float) * factor
        shapes = (
            [float(shaken)]
            if not np.ndim(value)
            else [*(shaken, shaken.ravel()[:-1], np.resize(shaken, (2, 3)), shaken.astype('f4'))]
        )
        return generator.choice([*shapes, generator.choice(ODD)])


def run(make: Callable[[Path], Any], name: str, count: int, seed: int, minutes: float) -> bool:
    """Give `count` inputs to what `make` makes; print what came of them."""
    outcomes: Counter[str] = Counter()
    slowest, begin = 0.0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        take = make(Path(folder))
        for number in range(count):
            if time.monotonic() - begin > 60.0 * minutes:
                break
            generator = random.Random(f'{name} {seed} {number}')
            started = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, 10.0)
            try:
                outcomes[take(generator)] += 1
            except IdentError as error:
                good = error.message.isprintable() and error.code != ErrorCode.INTERNAL
                outcomes['refused' if good else 'badly said'] += 1
                if not good:
                    print(f'{name} {number}: {error.message!r}', flush=True)
            except Slow:
                outcomes['over 10 s'] += 1
                print(f'{name} {number}: over 10 s', flush=True)
            except MemoryError:
                outcomes['over 2 GiB'] += 1
                print(f'{name} {number}: over 2 GiB', flush=True)
            except Exception:
                outcomes['traceback'] += 1
                print(f'{name} {number}\n{traceback.format_exc(limit=-3)}', flush=True)
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
            slowest = max(slowest, time.process_time() - started)
    seconds = time.monotonic() - begin
    told = ', '.join(f'{n} {what}' for what, n in sorted(outcomes.items()))
    print(f'{name}: {sum(outcomes.values())} in {seconds:.0f} s, slowest {slowest:.2f} s; {told}')
    return not set(outcomes) - {'taken', 'refused'}


def main() -> int:
    """Make, give, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--urdf', type=int, default=1000, help='needs pinocchio')
    parser.add_argument('--mjcf', type=int, default=1000, help='needs pinocchio')
    parser.add_argument('--simulators', type=int, default=0, help='needs MuJoCo')
    parser.add_argument('--lerobot', type=int, default=1000, help='needs pyarrow')
    for name in ('machines', 'columns', 'messages', 'goals'):
        parser.add_argument(f'--{name}', type=int, default=1000)
    parser.add_argument('--results', type=int, default=100)
    parser.add_argument('--checkpoints', type=int, default=10)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--minutes', type=float, default=1e9, help='longest time of each kind')
    args = parser.parse_args()
    warnings.simplefilter('ignore')
    signal.signal(signal.SIGPROF, too_long)
    used = int(Path('/proc/self/statm').read_text().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (used + (2 << 30), resource.RLIM_INFINITY))
    kinds: tuple[tuple[str, Callable[[Path], Any]], ...] = (
        ('machines', Machines),
        ('urdf', Urdf),
        ('mjcf', Mjcf),
        ('simulators', Simulators),
        ('columns', Columns),
        ('lerobot', Lerobot),
        ('messages', Messages),
        ('goals', Goals),
        ('results', Results),
        ('checkpoints', Checkpoints),
    )
    good = [run(make, name, getattr(args, name), args.seed, args.minutes) for name, make in kinds]
    return not all(good)


if __name__ == '__main__':
    sys.exit(main())
