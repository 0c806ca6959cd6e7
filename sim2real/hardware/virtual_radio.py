"""The radio's end of ``datagram.py``: one sender, and increasing numbers."""

from __future__ import annotations

import math
import secrets

from sim2real.hardware.datagram import (
    AHEAD,
    HALF,
    NUMBERS,
    SEALED_NUMBERS,
    SILENCE_S,
    Datagram,
    answer,
    read_request,
)


class VirtualRadio:
    """Requests of the sender that was heard first, until it is silent.

    Args:
        key: Key that the computer shares; none by default.
    """

    def __init__(self, key: bytes | None = None) -> None:
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._sender: object = None
        self._session: bytes | None = None
        self._number: int | None = None
        self._heard = -math.inf

    def receive(self, datagram: bytes, sender: object, now: float) -> bytes | None:
        """Packets for the servos; None for a datagram that is a stranger's, old or invalid.

        Args:
            datagram: What arrived.
            sender: From where.
            now: ``time.monotonic``.
        """
        request = read_request(datagram, self._key)
        if request is None:
            return None
        held = now - self._heard <= SILENCE_S
        if self._key is not None and request.number == 0:
            return self._begin(request, sender, now) if not held or self._number == 0 else None
        ours = (sender, request.session) == (self._sender, self._session)
        anyone = self._key is None and not held
        if not anyone and not (ours and self._fresh(request.number)):
            return None
        self._sender, self._session, self._number = sender, request.session, request.number
        released = request.number is not None and not request.data
        self._heard = -math.inf if released else now
        return request.data

    def _begin(self, request: Datagram, sender: object, now: float) -> bytes | None:
        """Answer the first datagram of a session, with the same session if it is repeated."""
        half = (request.session or b"")[:HALF]
        again = self._session is not None and (sender, half) == (self._sender, self._session[:HALF])
        if now - self._heard <= SILENCE_S:
            return b"" if again else None
        self._session = half + secrets.token_bytes(HALF)
        self._sender, self._number, self._heard = sender, 0, now
        return b""

    def _fresh(self, number: int | None) -> bool:
        """Whether a number is a little larger than the last; those without are of a bridge."""
        if number is None or self._number is None:
            return True
        return 0 < (number - self._number) % self._numbers <= AHEAD

    def answer(self, clock_s: float, replies: bytes) -> bytes:
        """The datagram that answers the last request."""
        if self._number is None:
            return replies
        return answer(self._number, clock_s, replies, self._session or b"", self._key)
