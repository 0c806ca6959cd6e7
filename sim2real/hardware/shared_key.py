"""Authentication of datagrams with a key that both ends share.

A sealed datagram is its content followed by the first 16 bytes of the content's HMAC-SHA-256
(RFC 2104). It is not encrypted.
"""

from __future__ import annotations

import hmac
import os
from pathlib import Path

from sim2real.errors import InputError
from sim2real.structured import read_text

VARIABLE = "SIM2REAL_KEY"
SHORTEST, CODE_BYTES = 16, 16
"""Characters of a key, bytes of a code."""


def shared_key(file: str | os.PathLike[str] | None = None) -> bytes | None:
    """The key in a file, or by default in ``SIM2REAL_KEY``, stripped; None if there is none.

    ``InputError`` if the file cannot be read, or the key is too short.
    """
    text = os.environ.get(VARIABLE) if file is None else read_text(Path(file))
    if text is None:
        return None
    key = text.strip()
    if len(key) < SHORTEST:
        found = f"a key of {len(key)} characters"
        raise InputError(VARIABLE if file is None else file, "", found, f"at least {SHORTEST}")
    return key.encode()


def sealed(content: bytes, key: bytes | None) -> bytes:
    """The datagram with ``content``; the content alone without a key."""
    return content if key is None else content + _code(content, key)


def unsealed(datagram: bytes, key: bytes | None) -> bytes | None:
    """The content of a datagram; None if it was sealed with another key or not at all."""
    if key is None:
        return datagram
    content, code = datagram[:-CODE_BYTES], datagram[-CODE_BYTES:]
    return content if hmac.compare_digest(code, _code(content, key)) else None


def _code(content: bytes, key: bytes) -> bytes:
    return hmac.digest(key, content, "sha256")[:CODE_BYTES]
