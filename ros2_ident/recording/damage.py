# SPDX-License-Identifier: Apache-2.0
"""What a damaged file has lost, counted and said in one sentence."""

from collections.abc import Mapping
from dataclasses import dataclass, field


class Damage(Exception):
    """A part of a file that cannot be used; the text says what is wrong with it."""


@dataclass
class Losses:
    """What is wrong with one file.

    Attributes:
        size: The file's size, bytes.
        whole: Messages read.
        messages: Messages known to be lost; 0 where nothing in the file tells.
        end: First byte that could not be read where the file breaks off, or None.
        blocks: Compressed blocks inside the file that are damaged.
        skipped: Bytes between the blocks that make no sense.
        unknown: Messages of a topic that is described nowhere.
        counted: The file itself states how many messages it holds.
        said: Whatever else was found, without subject.
    """

    size: int = 0
    whole: int = 0
    messages: int = 0
    end: int | None = None
    blocks: int = 0
    skipped: int = 0
    unknown: int = 0
    counted: bool = False
    said: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Add something found; the same twice is said once, and no more than a few things."""
        if text not in self.said and len(self.said) < 4:
            self.said.append(text)

    def expect(self, counts: Mapping[str, int], found: Mapping[str, int]) -> None:
        """Compare the messages that a file states with those found, topic by topic."""
        self.messages = sum(max(0, n - found.get(topic, 0)) for topic, n in counts.items())

    @property
    def text(self) -> str:
        """What is wrong, without subject; empty where nothing is."""
        parts = []
        if self.end is not None:
            parts.append(f'the file breaks off after byte {self.end} of {self.size}')
        if self.blocks:
            parts.append(
                f'{self.blocks} {"block" if self.blocks == 1 else "blocks"} inside '
                f'{"is" if self.blocks == 1 else "are"} damaged'
            )
        if self.skipped:
            parts.append(f'{self.skipped} bytes make no sense')
        if self.unknown:
            parts.append(f'{self.unknown} messages belong to no topic')
        parts += self.said
        if self.messages and not parts:
            parts.append('messages are missing')
        return ' and '.join(parts)

    def sentence(self, path: object, remedy: str) -> str:
        """Return the warning about a file of which something was read.

        Args:
            path: The file.
            remedy: What to do about it.
        """
        lost = f', {self.messages} are lost' if self.messages else ''
        read = f'{self.whole} whole messages were read{lost}'
        return f'{path}: is damaged: {self.text}, {read}; {remedy}'
