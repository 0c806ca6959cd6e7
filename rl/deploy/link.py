"""Protocol between a swimming robot and the computer that controls it.

UDP datagrams, one JSON object each. The robot sends its state 50 times per second to the address
that sent the last set-points; the computer answers each::

    {"t_s": 12.34, "pose": [0.51, -0.02, 0.13], "joints_rad": [0.11, 0.20, -0.05]}
    {"number": 617, "joints_rad": [0.15, 0.31, -0.12]}

``t_s`` is the robot's clock, which increases. ``pose`` is x and y of the head's centre of mass in m
and its heading in rad, in the pool's frame, from the overhead camera. ``joints_rad`` are measured
or desired angles, from head to tail. Missing measurements are ``null``.

``number`` increases, and the robot ignores set-points that arrive out of order. Number 0 starts a
swim: the robot answers with its state and does not move. A robot that receives nothing for
``SILENCE_S`` moves to its rest angles.
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

from sim2real.arrays import Array
from sim2real.errors import InputError

SILENCE_S = 0.5
"""Time without a datagram after which either side regards the connection as lost."""
LARGEST = 2048
"""Largest datagram in bytes."""


@dataclass(frozen=True)
class Telemetry:
    """State: robot clock ``t_s``, pose (3,), joint angles (J,); NaN if not measured."""

    t_s: float
    pose: Array
    joint: Array


@dataclass(frozen=True)
class SetPoints:
    """Desired joint angles, shape (J,); empty with number 0, which starts a swim."""

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
    """Parse the robot's datagram; None if it is not of a robot with J joints."""
    content = _object(datagram)
    t, pose = _numbers([content.get("t_s")], 1), _numbers(content.get("pose"), 3)
    joint = _numbers(content.get("joints_rad"), J)
    if t is None or pose is None or joint is None or not np.isfinite(t[0]):
        return None
    return Telemetry(float(t[0]), pose, joint)


def read_set_points(datagram: bytes, J: int) -> SetPoints | None:
    """Parse the computer's datagram; None if it is not for a robot with J joints."""
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
    """An array of ``count`` numbers, NaN for null; None if ``values`` is anything else."""
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
        strange: Number of datagrams that were not telemetry of such a robot.

    Raises:
        InputError: If the address is invalid.
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
            problem = f"{url!r} ({error})"
            raise InputError("--port", "", problem, "a robot at udp://HOST:PORT") from None

    def begin(self) -> None:
        """Ask the robot for its state; it does not move yet."""
        self._number = 0
        self._send(SetPoints(0, np.empty(0)))

    def send(self, joint: Array) -> None:
        """Send desired angles in rad, shape (J,)."""
        self._number += 1
        self._send(SetPoints(self._number, joint))

    def _send(self, sent: SetPoints) -> None:
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(set_point_bytes(sent))

    def receive(self, wait_s: float) -> list[Telemetry]:
        """Wait for telemetry and return all that has arrived; empty after ``wait_s``."""
        deadline, telemetry = time.monotonic() + wait_s, list[Telemetry]()
        while not telemetry:
            remaining = deadline - time.monotonic()
            if remaining <= 0 or not select.select([self._socket], [], [], remaining)[0]:
                break
            telemetry = self._waiting()
        return telemetry

    def _waiting(self) -> list[Telemetry]:
        telemetry = []
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                message = read_telemetry(self._socket.recv(LARGEST), self._J)
                self.strange += message is None
                telemetry += [message] if message else []
        return telemetry

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
