# SPDX-License-Identifier: Apache-2.0
"""A writer of bags whose MCAP files carry every checksum that the format has."""

from struct import Struct
import zlib

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from ros2_ident.recording.mcap_records import FOOTER_SIZE, HEAD, MAGIC

_CRC = Struct('<I')
_PIECE = 1 << 20
# Places of checksums: in a chunk after its record's head and three numbers; at the file's end.
_IN_CHUNK = HEAD.size + 24
_FOOTER = HEAD.size + FOOTER_SIZE + len(MAGIC)


class ChecksummedMcapWriter(McapWriter):
    """rosbags' writer, which leaves the checksums at 0, for none, with them filled in."""

    def close_chunk(self) -> None:
        """Close the pending chunk, with the checksum of what is in it."""
        begin, crc = self.bio.tell(), zlib.crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin + _IN_CHUNK)
        self.bio.write(_CRC.pack(crc))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Close the file, with the checksums of its data and of its summary."""
        super().close(version, metadata)
        with self.path.open('r+b') as file:
            footer = file.seek(-_FOOTER, 2)
            file.seek(footer + HEAD.size)
            summary = int.from_bytes(file.read(8), 'little')
            data_end = summary - HEAD.size - _CRC.size
            file.seek(0)
            crc, left = 0, data_end
            while left:
                piece = file.read(min(left, _PIECE))
                crc = zlib.crc32(piece, crc)
                left -= len(piece)
            file.seek(data_end + HEAD.size)
            file.write(_CRC.pack(crc))
            file.seek(summary)
            crc = zlib.crc32(file.read(footer + HEAD.size + 16 - summary))
            file.write(_CRC.pack(crc))


class BagWriter(Writer):
    """rosbags' writer of bags with the storage above."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChecksummedMcapWriter}
