# SPDX-License-Identifier: Apache-2.0
"""The one table of the identifier's parameters; declarations, template and page come from it.

`python -m ros2_ident.ros.parameter_table` writes config/identifier.yaml and docs/parameters.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import textwrap

from ros2_ident.files import write_text
from ros2_ident.search import GeneticSettings

Value = bool | int | float | str | tuple[str, ...]

_GENETIC = GeneticSettings()
_LARGEST = 2**63 - 1


@dataclass(frozen=True)
class Entry:
    """One parameter of the node.

    Attributes:
        name: Its name.
        kind: `bool`, `integer`, `double`, `string` or `string_array`.
        default: Its value where nobody sets one.
        text: What it does and when to change it.
        low: Least value of a number; None where there is no range.
        high: Largest value of a number.
        unit: Unit of a number, empty for a count.
        choices: Allowed strings, empty for any.
        read_only: Whether it is fixed when the node starts.
    """

    name: str
    kind: str
    default: Value
    text: str
    low: float | None = None
    high: float | None = None
    unit: str = ''
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def description(self) -> str:
        """What tools show for it, with the unit and the choices."""
        unit = f' [{self.unit}]' if self.unit else ''
        choices = f' One of {", ".join(self.choices)}.' if self.choices else ''
        return f'{self.text}{choices}{unit}'

    @property
    def range(self) -> str:
        """Its range in words, empty where there is none."""
        if self.low is None or self.high is None:
            return ''
        high = '' if self.high >= _LARGEST or math.isinf(self.high) else f'{self.high:g}'
        return f'{self.low:g} to {high}' if high else f'from {self.low:g}'


def _count(
    name: str,
    default: int,
    text: str,
    low: int = 0,
    high: int = _LARGEST,
    *,
    read_only: bool = False,
) -> Entry:
    return Entry(name, 'integer', default, text, low, high, read_only=read_only)


TABLE: tuple[Entry, ...] = (
    Entry(
        'machine_file',
        'string',
        '',
        'Path of the machine file: what is known of the machine and the box of what is not. '
        'A goal may name another one. Without either, what is heard live is taken for an arm that '
        'robot_description describes.',
    ),
    Entry(
        'drives',
        'string_array',
        (),
        'Drives to identify or to diagnose where a goal names none; the others follow their '
        'recorded motion. Empty: all of the machine.',
    ),
    Entry(
        'auto_start',
        'bool',
        True,
        'Identify by itself when the stream of measurements has ended. Switch it off where only '
        'the action shall start a run.',
    ),
    Entry(
        'end_of_stream',
        'double',
        2.0,
        'The stream has ended when nothing came for this long. Raise it where the drives pause.',
        0.2,
        3600.0,
        's',
    ),
    Entry(
        'keep_streams',
        'bool',
        False,
        'Keep the data of a stream that has ended when the next one begins. By default each '
        'stream is taken by itself, so that a bag played twice is not counted twice. A stream '
        'whose stamps go on after a pause, as of a bag, is always one.',
    ),
    Entry(
        'joint_names',
        'string_array',
        (),
        'What the numbers of a Float64MultiArray are, in its order, live and in bags: joints, or '
        'with an interface as joint/velocity.',
    ),
    _count(
        'buffer_messages',
        2_000_000,
        'Messages held of each stream; when full, later ones are only counted.',
        1000,
        100_000_000,
    ),
    Entry(
        'missing_warning',
        'double',
        0.001,
        'Share of missing samples from which the diagnostics warn.',
        0.0,
        1.0,
    ),
    Entry(
        'output_directory',
        'string',
        '~/.ros/ros2_ident',
        'Every run makes a folder in here: with the result file and the overlay bag, or with the '
        'diagnosis and its charts. Empty: nothing is written.',
    ),
    _count(
        'spool_size',
        1000,
        'What arrives is also written to a file in output_directory/spool, so that it is found '
        'again after a restart, up to this many MB; 0: not at all.',
        0,
        1_000_000,
        read_only=True,
    ),
    Entry(
        'allowed_directory',
        'string',
        '',
        'Goals may name files inside of this directory only, wherever links lead. Empty: any '
        'file that the node can read.',
        read_only=True,
    ),
    Entry(
        'bag_topics.state',
        'string',
        '/joint_states',
        'Topic of the measured positions and velocities in bags that are read directly.',
    ),
    Entry(
        'bag_topics.effort',
        'string',
        '/effort',
        'Topic of the measured efforts in such bags; none where they are in the state topic.',
    ),
    Entry(
        'bag_topics.command',
        'string',
        '/joint_command',
        'Topic of the set-points in such bags; none where there is none.',
    ),
    _count(
        'seed', 1, 'Seed of the random generator: the same seed and data give the same result.', 1
    ),
    _count(
        'initial_population',
        _GENETIC.initial_population,
        'Candidates of the first generation.',
        1,
        10_000_000,
    ),
    _count('survivors', _GENETIC.survivors, 'Most candidates that become parents.', 1, 100_000),
    _count('children', _GENETIC.children, 'Children of each parent.', 1, 100_000),
    _count(
        'generations', _GENETIC.generations, 'Generations, the first one included.', 1, 1_000_000
    ),
    Entry(
        'range_reduction',
        'double',
        _GENETIC.range_reduction,
        'Shrinkage of the mutation range from one generation to the next.',
        0.001,
        1.0,
    ),
    Entry(
        'min_distance',
        'double',
        _GENETIC.min_distance,
        'Least distance between survivors in the unit cube of the first generation. Raise it '
        'where the search gets trapped.',
        0.0,
        10.0,
    ),
    Entry(
        'mutation',
        'string',
        _GENETIC.mutation,
        'Law of the mutation.',
        choices=('gaussian_root', 'laplace', 'normal'),
    ),
    _count(
        'stagnation_generations',
        _GENETIC.stagnation_generations,
        'Stop after so many generations without improvement; 0 for never.',
        0,
        1_000_000,
    ),
    Entry(
        'refine',
        'bool',
        True,
        'Refine the best candidates by least squares after the genetic algorithm. Applies to runs '
        'that start by themselves; a goal says it itself.',
    ),
    _count('evaluation_budget', 0, 'Most candidates that are simulated; 0 for no limit.'),
    Entry(
        'time_budget',
        'double',
        0.0,
        'Time after which a run of either action ends with the best so far where its goal names '
        'none; 0 for no limit.',
        0.0,
        1e7,
        's',
    ),
    _count(
        'workers',
        0,
        'Threads that simulate; 0: one for each processor, one less while data arrives.',
        0,
        1024,
    ),
    Entry('progress_rate', 'double', 5.0, 'Most progress messages per second.', 0.1, 50.0, 'Hz'),
    Entry(
        'preview_rate',
        'double',
        1.0,
        'How often the simulated and residual effort of the best candidate so far come during a '
        'run, at most; they are thinned out and take at most a twentieth of its time. 0: only at '
        'its end.',
        0.0,
        10.0,
        'Hz',
    ),
    Entry(
        'result_timeout',
        'double',
        900.0,
        'How long after its end a goal can still be asked for its result; `~/result` and `~/gap` '
        'keep the last one for as long as the node runs.',
        10.0,
        1e6,
        's',
        read_only=True,
    ),
)

BY_NAME = {entry.name: entry for entry in TABLE}


def literal(value: Value) -> str:
    """Return a default as it is written in YAML; a double always has its point."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, tuple):
        return '[' + ', '.join(value) + ']'
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, float):
        return f'{value:.1f}' if value == int(value) and abs(value) < 1e7 else repr(value)
    return str(value)


def yaml_template(table: Sequence[Entry] = TABLE) -> str:
    """Return config/identifier.yaml: every parameter at its default, with what it does."""
    lines = [
        '# SPDX-License-Identifier: Apache-2.0',
        '# Parameters of the node `identifier`, each at its default. Made from',
        '# ros2_ident/ros/parameter_table.py; copy it and change the copy.',
        '# A double needs its point: write 1.0, not 1.',
        '#   ros2 run ros2_ident identifier --ros-args --params-file identifier.yaml',
        '/**:',
        '  ros__parameters:',
    ]
    groups: set[str] = set()
    for entry in table:
        group, _, name = entry.name.rpartition('.')
        indent = '    '
        if group:
            if group not in groups:
                lines.append(f'    {group}:')
                groups.add(group)
            indent += '  '
        text = entry.description + (f' ({entry.range})' if entry.range else '')
        lines += textwrap.wrap(
            text, 99, initial_indent=f'{indent}# ', subsequent_indent=f'{indent}# '
        )
        # rcl cannot tell the type of an empty list
        mark = '# ' if entry.default == () else ''
        lines.append(f'{indent}{mark}{name}: {literal(entry.default)}')
    return '\n'.join(lines) + '\n'


def markdown(table: Sequence[Entry] = TABLE) -> str:
    """Return docs/parameters.md."""
    lines = [
        '# Parameters of `identifier`',
        '',
        'Made by `python -m ros2_ident.ros.parameter_table`; a test compares it with the table.',
        '',
        'A run works with the values in force when it starts and echoes them in its result; a',
        'change during a run takes effect at the next one. A double needs its point:',
        '`time_budget: 10` is refused, write `10.0`.',
        '',
        '| parameter | default | range | meaning |',
        '| --- | --- | --- | --- |',
    ]
    for entry in table:
        text = entry.description + (' Fixed when the node starts.' if entry.read_only else '')
        lines.append(
            f'| `{entry.name}` | `{literal(entry.default)}` | {entry.range} | {text} |'
        )
    lines += [
        '',
        '## Topics and quality of service',
        '',
        '`joint_states`, `effort` and `joint_command` can be remapped',
        '(`--ros-args -r joint_states:=/arm/joint_states`). They are subscribed best effort, keep',
        'last 1000, so that they match every publisher. To change `history`, `depth` or',
        '`reliability`, as where the machine is busy and the publishers are reliable:',
        '',
        '<!-- not run: needs ros2 -->',
        '```bash',
        'ros2 run ros2_ident identifier --ros-args \\',
        '  -p qos_overrides./joint_states.subscription.reliability:=reliable',
        '```',
    ]
    return '\n'.join(lines) + '\n'


def generated(root: Path) -> dict[Path, str]:
    """Return the files made from the table, below the root of the source tree."""
    return {
        root / 'config/identifier.yaml': yaml_template(),
        root / 'docs/parameters.md': markdown(),
    }


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[2]).items():
        write_text(path, text, replace=True)
        print(path)
