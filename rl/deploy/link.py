"""What goes to and fro between a robot that swims and the computer that steers it.

Datagrams over UDP, one JSON object each. The robot tells where it is 50 times a second, to whoever
sent it set-points last; the computer answers each::

    {"t_s": 12.34, "pose": [0.51, -0.02, 0.13], "joints_rad": [0.11, 0.20, -0.05]}
    {"number": 617, "joints_rad": [0.15, 0.31, -0.12]}

``t_s`` is the robot's clock, which grows. ``pose`` is x and y of the head's centre of mass in m and
its heading in rad, in the pool's frame; the overhead camera knows it. ``joints_rad`` are measured
angles, or desired ones, from head to tail. What was not seen is ``null``.

``number`` counts up, and the robot passes over set-points that come too late. Number 0 begins a
swim: the robot answers with where it is, and moves nothing. A robot that hears nothing for
``SILENCE_S`` goes to its rest angles by itself.
"""

from __future__ import annotations

import contextlib
import json
import select
import socket
import time
from dataclasses import dataclass
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError

Array = NDArray[np.float64]

SILENCE_S = 0.5
"""Either side takes the other for lost after so long without a word."""
LARGEST = 2048
"""Bytes of a datagram."""


@dataclass(frozen=True)
class Telemetry:
    """Where the robot is: ``t_s`` by its own clock, pose (3,), joint angles (J,), NaN if unseen."""

    t_s: float
    pose: Array
    joint: Array


@dataclass(frozen=True)
class SetPoints:
    """Desired joint angles, shape (J,); none with number 0, which begins a swim."""

    number: int
    joint: Array


def telemetry_bytes(telemetry: Telemetry) -> bytes:
    """The robot's datagram."""
    content = {"t_s": round(telemetry.t_s, 9), "pose": _list(telemetry.pose)}
    return json.dumps(content | {"joints_rad": _list(telemetry.joint)}).encode()


def set_point_bytes(sent: SetPoints) -> bytes:
    """The computer's datagram."""
    return json.dumps({"number": sent.number, "joints_rad": _list(sent.joint)}).encode()


def read_telemetry(datagram: bytes, J: int) -> Telemetry | None:
    """The robot's datagram taken apart; None if it is none of a robot with J joints."""
    content = _object(datagram)
    t, pose = _numbers([content.get("t_s")], 1), _numbers(content.get("pose"), 3)
    joint = _numbers(content.get("joints_rad"), J)
    if t is None or pose is None or joint is None or not np.isfinite(t[0]):
        return None
    return Telemetry(float(t[0]), pose, joint)


def read_set_points(datagram: bytes, J: int) -> SetPoints | None:
    """The computer's datagram taken apart; None if it is none for a robot with J joints."""
    content = _object(datagram)
    number = content.get("number")
    if type(number) is not int or number < 0:
        return None
    joint = _numbers(content.get("joints_rad"), J if number else 0)
    if joint is None or not np.isfinite(joint).all():
        return None
    return SetPoints(number, joint)


def _list(values: Array) -> list[float | None]:
    return [round(float(x), 9) if np.isfinite(x) else None for x in values]


def _object(datagram: bytes) -> dict[str, object]:
    try:
        content = json.loads(datagram)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _numbers(values: object, count: int) -> Array | None:
    """So many numbers, NaN for null; None if they are not."""
    if not isinstance(values, list) or len(values) != count:
        return None
    if not all(value is None or type(value) in (int, float) for value in values):
        return None
    with contextlib.suppress(OverflowError):
        return np.array([np.nan if x is None else x for x in values], dtype=np.float64)
    return None


class Link:
    """The computer's end.

    Attributes:
        strange: Datagrams that were no telemetry of such a robot.

    Raises:
        InputError: If the address is none.
    """

    def __init__(self, url: str, J: int) -> None:
        self._J, self._number, self.strange = J, 0, 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            address = urlsplit(url)
            if address.scheme != "udp":
                raise ValueError("not udp")
            self._socket.connect((address.hostname, address.port or 0))
            self._socket.getpeername()
        except (OSError, ValueError, UnicodeError, TypeError) as error:
            self._socket.close()
            found = f"{url!r} ({error})"
            raise InputError("--port", "", found, "a robot at udp://HOST:PORT") from None

    def begin(self) -> None:
        """Ask the robot where it is; it moves nothing yet."""
        self._number = 0
        self._send(SetPoints(0, np.empty(0)))

    def send(self, joint: Array) -> None:
        """Send desired angles in rad, shape (J,)."""
        self._number += 1
        self._send(SetPoints(self._number, joint))

    def _send(self, sent: SetPoints) -> None:
        # refused: nobody listens there just now, as while the robot starts anew
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(set_point_bytes(sent))

    def receive(self, wait_s: float) -> list[Telemetry]:
        """All that has arrived, as soon as something has; empty if by ``wait_s`` nothing has."""
        deadline, found = time.monotonic() + wait_s, list[Telemetry]()
        while not found:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._socket], [], [], left)[0]:
                break
            found = self._waiting()
        return found

    def _waiting(self) -> list[Telemetry]:
        found = []
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                one = read_telemetry(self._socket.recv(LARGEST), self._J)
                self.strange += one is None
                found += [one] if one else []
        return found

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
