# SPDX-License-Identifier: Apache-2.0
"""The seal on a case's label: its hash is public before the diagnosis, its content is not.

The content is kept beside the hash as unreadable bytes so that an interrupted run goes on; its key
is the seed of the run, which the diagnosis is never told. The hash holds a random nonce, so it
cannot be found by trying labels.
"""

from collections.abc import Mapping, Sequence
import hashlib
import json
import os
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError

_NONCE = 16


def _stream(seed: int, nonce: bytes, length: int) -> bytes:
    return hashlib.shake_256(f'blind {seed} '.encode() + nonce).digest(length)


def _xor(left: bytes, right: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(left, right, strict=True))


def _canonical(label: Mapping[str, Any]) -> bytes:
    return json.dumps(label, sort_keys=True, separators=(',', ':'), allow_nan=False).encode()


def close(label: Mapping[str, Any], seed: int) -> dict[str, str]:
    """Seal a label.

    Returns:
        `nonce`, `sha256` of nonce and canonical JSON, and `box`, all in hexadecimal digits.
    """
    text = _canonical(label)
    nonce = os.urandom(_NONCE)
    return {
        'nonce': nonce.hex(),
        'sha256': hashlib.sha256(nonce + text).hexdigest(),
        'box': _xor(text, _stream(seed, nonce, len(text))).hex(),
    }


def unseal(sealed: Mapping[str, str], seed: int) -> dict[str, Any]:
    """Open a sealed label.

    Raises:
        IdentError: INVALID_GOAL where the seed is another or the seal is broken.
    """
    nonce, box = bytes.fromhex(sealed['nonce']), bytes.fromhex(sealed['box'])
    text = _xor(box, _stream(seed, nonce, len(box)))
    if hashlib.sha256(nonce + text).hexdigest() != sealed['sha256']:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            'the seal of a case does not fit; give the seed the run was begun with, or take an '
            'empty directory',
        )
    label: dict[str, Any] = json.loads(text)
    return label


def digest_of(label: Mapping[str, Any], nonce: str) -> str:
    """Return the hash of a label with its nonce, given in hexadecimal digits."""
    return hashlib.sha256(bytes.fromhex(nonce) + _canonical(label)).hexdigest()


def manifest(seals: Sequence[str]) -> str:
    """Return one hash over the hashes of all cases, in their order."""
    return hashlib.sha256(''.join(seals).encode()).hexdigest()
