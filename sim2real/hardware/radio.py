"""The radio of a bus: its datagrams, and both ends, computer and robot.

To the radio: ``4C 58``, an increasing number (two bytes, low first), then LX packets, which it
sends on its bus in order. Its answer: the same four bytes, its clock in microseconds at reception
of the datagram (eight bytes, low first), then all bytes of the servos' replies. A simple bridge
from UDP to serial works as well: servos ignore bytes before a header, and an answer that does not
begin with ``4C 58`` consists of replies only.

Where radio and computer share a key, ``4C 59`` is followed by a session (16 bytes), a number of
four bytes and the rest as above, and authenticated by the first 16 bytes of its HMAC-SHA-256 (RFC
2104). The first eight bytes of the session are the computer's. It begins with number 0, no packets
and zeros in the place of the other eight, which the radio answers with random ones, so that no
earlier session can be replayed.

A radio should keep the sender that it heard first until that has been silent for ``SILENCE_S`` or
has sent no packets, and ignore numbers that are not 1 to ``AHEAD`` larger than the last
(``VirtualRadio`` does). Without a key the network must be trusted: whoever can send from the
computer's address can move the servos. Nothing is encrypted.
"""

import contextlib
import hmac
import math
import os
import secrets
import select
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from sim2real.errors import InputError
from sim2real.structured import read_text

VARIABLE = "SIM2REAL_KEY"
CODE_BYTES = 16
MARK, SEALED_MARK = b"\x4c\x58", b"\x4c\x59"
HALF = 8
"""Bytes of a session that each end chooses."""
LARGEST = 2048
NUMBERS = 1 << 16
SEALED_NUMBERS = 1 << 32
SILENCE_S = 0.5
"""Time without a datagram after which a radio takes another sender."""
AHEAD = 1000
"""Largest step of the number of a datagram."""
_CLOCK = 8
PORTS = "a serial port, socket://HOST:PORT, rfc2217://HOST:PORT or udp://HOST:PORT"
PATIENCE = 25
"""Datagrams without an answer after which a new session is begun, with a key."""


@dataclass(frozen=True, slots=True)
class Datagram:
    """A parsed datagram; ``number`` and ``clock_s`` are None, ``session`` empty if it has none."""

    data: bytes
    number: int | None = None
    clock_s: float | None = None
    session: bytes = b""


def opened(url: str, option: str, expected: str, *, bind: bool = False) -> socket.socket:
    """A UDP socket that does not block, connected to ``udp://HOST:PORT`` or bound to it."""
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.setblocking(False)
    try:
        address = urlsplit(url)
        if address.scheme != "udp":
            raise ValueError("not udp")
        if bind:
            end.bind((address.hostname or "127.0.0.1", address.port or 0))
        else:
            end.connect((address.hostname, address.port or 0))
            end.getpeername()
    except (OSError, ValueError, UnicodeError, OverflowError, TypeError) as error:
        end.close()
        raise InputError(option, "", f"{url!r} ({error})", expected) from None
    return end


def request(number: int, data: bytes, session: bytes = b"", key: bytes | None = None) -> bytes:
    """The datagram with ``data`` for the radio."""
    if key is None:
        return MARK + number.to_bytes(2, "little") + data
    return sealed(SEALED_MARK + session + number.to_bytes(4, "little") + data, key)


def answer(
    number: int, clock_s: float, data: bytes, session: bytes = b"", key: bytes | None = None
) -> bytes:
    """The datagram with the replies."""
    clock = round(1e6 * clock_s).to_bytes(_CLOCK, "little")
    return request(number, clock + data, session, key)


def read_request(datagram: bytes, key: bytes | None = None) -> Datagram | None:
    """Parse a datagram to the radio; None if it does not have this key."""
    if key is None:
        head = len(MARK) + 2
        if not datagram.startswith(MARK) or len(datagram) < head:
            return Datagram(datagram)
        return Datagram(datagram[head:], int.from_bytes(datagram[len(MARK) : head], "little"))
    content, start = unsealed(datagram, key), len(SEALED_MARK)
    head = start + 2 * HALF + 4
    if content is None or not content.startswith(SEALED_MARK) or len(content) < head:
        return None
    number = int.from_bytes(content[head - 4 : head], "little")
    return Datagram(content[head:], number, session=content[start : head - 4])


def read_answer(datagram: bytes, key: bytes | None = None) -> Datagram | None:
    """Parse a datagram from the radio; None if it does not have this key."""
    parsed = read_request(datagram, key)
    if parsed is None or parsed.number is None:
        return parsed
    if len(parsed.data) < _CLOCK:
        return Datagram(datagram) if key is None else None
    clock = int.from_bytes(parsed.data[:_CLOCK], "little") * 1e-6
    return Datagram(parsed.data[_CLOCK:], parsed.number, clock, parsed.session)


def shared_key(file: str | os.PathLike[str] | None = None, *, shortest: int = 16) -> bytes | None:
    """The key in a file, or by default in ``SIM2REAL_KEY``; None if there is none."""
    text = os.environ.get(VARIABLE) if file is None else read_text(Path(file))
    if text is None:
        return None
    key = text.strip()
    if len(key) < shortest:
        found = f"a key of {len(key)} characters"
        raise InputError(file or VARIABLE, "", found, f"at least {shortest}")
    return key.encode()


def sealed(content: bytes, key: bytes | None) -> bytes:
    """The datagram with ``content``; the content alone without a key."""
    return content if key is None else content + hmac.digest(key, content, "sha256")[:CODE_BYTES]


def unsealed(datagram: bytes, key: bytes | None) -> bytes | None:
    """The content of a datagram; None if it was sealed with another key or not at all."""
    if key is None:
        return datagram
    content = datagram[:-CODE_BYTES]
    return content if hmac.compare_digest(datagram, sealed(content, key)) else None


class UdpTransport:
    """A radio at ``udp://HOST:PORT``, which shares ``key``; missing answers are not errors."""

    together = True  # the radio sends requests in order

    def __init__(self, url: str, key: bytes | None = None) -> None:
        self.device_s: float | None = None  # clock of the radio at the last answered request
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._number, self._unanswered = 0, 0
        self._own, self._session = secrets.token_bytes(HALF), b""
        self._waiting = b""
        self._socket = opened(url, "--port", PORTS)

    def write(self, data: bytes) -> None:
        """Send ``data`` in one datagram; with a key once the radio has answered in this session."""
        self._unanswered += 1
        if self._key is not None and self._session and self._unanswered > PATIENCE:
            self._own, self._session = secrets.token_bytes(HALF), b""
        if self._key is not None and not self._session:
            self._number, self._waiting = 0, data
            self._send(request(0, b"", self._own + bytes(HALF), self._key))
            return
        self._number = (self._number + 1) % self._numbers
        self._send(request(self._number, data, self._session, self._key))

    def read(self, deadline: float) -> bytes:
        """Wait for bytes until ``deadline``; empty if none arrive."""
        while True:
            remaining = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._socket], [], [], remaining)[0]:
                return b""
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                reply = read_answer(self._socket.recv(LARGEST), self._key)
                if reply is None or reply.number not in (None, self._number):
                    continue
                if self._key is not None:
                    if not self._session and reply.session.startswith(self._own):
                        # the first answer of a session completes it
                        self._session, self._unanswered = reply.session, 0
                        self.write(self._waiting)
                    if reply.session != self._session:
                        continue
                self._unanswered = 0
                if reply.data:
                    self.device_s = reply.clock_s
                    return reply.data

    def close(self) -> None:
        """Release the radio and close the socket."""
        if self._number:
            self._number = (self._number + 1) % self._numbers
            self._send(request(self._number, b"", self._session, self._key))
        self._socket.close()

    def _send(self, datagram: bytes) -> None:
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(datagram)


class VirtualRadio:
    """Requests of the sender that was heard first, until it is silent; with a key, if given."""

    def __init__(self, key: bytes | None = None) -> None:
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._sender: object = None
        self._session, self._heard = b"", -math.inf
        self._number: int | None = None

    def receive(self, datagram: bytes, sender: object, now: float) -> bytes | None:
        """Packets for the servos; None for a datagram that is a stranger's, old or invalid."""
        request = read_request(datagram, self._key)
        if request is None:
            return None
        held, last = now - self._heard <= SILENCE_S, self._number
        if self._key is not None and request.number == 0:
            own = request.session[:HALF]
            if held:  # the request for this session may be repeated
                same = (sender, own, 0) == (self._sender, self._session[:HALF], last)
                return b"" if same else None
            self._session = own + secrets.token_bytes(HALF)
            self._sender, self._number, self._heard = sender, 0, now
            return b""
        if held or self._key is not None:
            step = 1  # those without a number are of a bridge
            if request.number is not None and last is not None:
                step = (request.number - last) % self._numbers
            ours = (sender, request.session) == (self._sender, self._session)
            if not ours or not 0 < step <= AHEAD:
                return None
        self._sender, self._session, self._number = sender, request.session, request.number
        released = request.number is not None and not request.data
        self._heard = -math.inf if released else now
        return request.data

    def answer(self, clock_s: float, replies: bytes) -> bytes:
        """The datagram that answers the last request."""
        if self._number is None:
            return replies
        return answer(self._number, clock_s, replies, self._session, self._key)
