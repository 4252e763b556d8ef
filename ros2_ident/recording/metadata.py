# SPDX-License-Identifier: Apache-2.0
"""A bag's metadata.yaml, as far as it helps: names of files, numbers of messages, checksums.

Nothing is taken from it that the files themselves say, so that a wrong one does no harm.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ros2_ident.recording.db3_scan import CHECKSUM

NAME = 'metadata.yaml'
# No recorder writes more.
_LARGEST = 1 << 22
_LOADER: type[yaml.SafeLoader] = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


@dataclass(frozen=True)
class Metadata:
    """What metadata.yaml says.

    Attributes:
        files: Names of the storage files, in the order of recording.
        counts: Messages by topic.
        checksums: By topic, where `write_bag` stated them.
    """

    files: tuple[str, ...]
    counts: Mapping[str, int] = field(default_factory=dict)
    checksums: Mapping[str, str] = field(default_factory=dict)


def read_metadata(folder: Path) -> Metadata | None:
    """Return what a bag's metadata.yaml says, or None where there is none that makes sense."""
    path = folder / NAME
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            return None
        data = yaml.load(path.read_text(encoding='utf-8'), Loader=_LOADER)  # noqa: S506 - safe
        info = data['rosbag2_bagfile_information']
        counts: Counter[str] = Counter()
        for entry in info['topics_with_message_count']:
            counts[str(entry['topic_metadata']['name'])] += int(entry['message_count'])
        custom = info.get('custom_data') or {}
        sums = {k[len(CHECKSUM) :]: str(v) for k, v in custom.items() if k.startswith(CHECKSUM)}
        files = tuple(Path(str(x)).name for x in info['relative_file_paths'])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    except yaml.YAMLError:
        return None
    return Metadata(files, counts, sums)
