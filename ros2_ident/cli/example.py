# SPDX-License-Identifier: Apache-2.0
"""`ident example`: a bag and machine files to try the commands on."""

import argparse
from pathlib import Path

_BAG = Path('bags', 'axis_reversals')


def shipped(inside: Path | str) -> Path:
    """Return where what comes with the package lies: in a wheel, a clone, or a ROS prefix.

    Args:
        inside: Its path in the clone, as `config/emps.yaml`.
    """
    import ros2_ident

    package = Path(ros2_ident.__file__).parent
    shares = (folder / 'share' / package.name for folder in package.parents)
    places = [root / inside for root in (package / 'examples', package.parent, *shares)]
    return next((place for place in places if place.exists()), places[0])


def run(args: argparse.Namespace) -> int:
    """Copy the files and print the next commands."""
    import shlex
    import shutil
    import sys

    from ros2_ident.files import replacing_directory

    out = Path(args.out)
    with replacing_directory(out) as folder:
        shutil.copytree(shipped(_BAG), folder / _BAG, copy_function=shutil.copyfile)
        (folder / 'config').mkdir()
        for file in sorted(shipped('config').iterdir()):
            if file.suffix in ('.yaml', '.urdf'):
                shutil.copyfile(file, folder / 'config' / file.name)
    print(f'written: {out}; now:')
    machine = out / 'config' / 'emps.yaml'
    program = 'ros2-ident' if sys.argv[0].endswith('ros2-ident') else 'ident'  # as uvx knows it
    for command, results in (('identify', 'axis'), ('diagnose', 'gap')):
        words = (command, out / _BAG, '--machine', machine, '--out', out / results)
        print(f'  {program} ' + shlex.join(map(str, words)))
    return 0
