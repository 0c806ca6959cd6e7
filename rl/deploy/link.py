"""Protocol between a swimming robot and the computer that controls it.

UDP datagrams, one JSON object each. The robot sends its state 50 times per second to the computer
that controls it, which answers each with set-points::

    {"session": "b7...e1", "t_s": 12.34, "pose": [0.51, -0.02, 0.13], "joints_rad": [0.11, 0.20]}
    {"session": "b7...e1", "number": 617, "joints_rad": [0.15, 0.31]}

``t_s`` is the robot's clock, which increases. ``pose`` is x and y of the head's centre of mass in m
and its heading in rad, in the pool's frame, from the overhead camera. ``joints_rad`` are measured
or desired angles, from head to tail. Missing measurements are ``null``.

**Session.** The computer begins with number 0, no angles and 16 hexadecimal digits of its own as
``session``, repeated until the robot answers. The robot does not move, answers with its state, and
appends 16 random digits of its own to ``session``; both ends use all 32 from then on. The robot
keeps the address and session of the first sender and ignores all others, and number 0 too, until it
has received no set-points for ``SILENCE_S``; it then moves to its rest angles and sends nothing.

**Numbers** increase. The robot ignores one that is not larger than the last, or larger by more than
``AHEAD`` and the control periods of 20 ms since the last: neither an old nor a huge number takes
effect. It limits angles to those of its joints.

**Key.** Where both ends share a key, 16 bytes follow each JSON object, see
``sim2real.hardware.radio``, and datagrams without them are ignored.

Without a key, whoever can read the traffic and send from the computer's address can move the robot:
the network must be trusted. With a key they cannot, and cannot replay an earlier session, but they
can read all, delay a start by replaying its first datagram, and block the traffic. Nothing is
encrypted.

A tracker sends poses to ``sim2real swim --pose`` in the same format, as a robot without joints::

    {"session": "5c...02", "t_s": 12.34, "pose": [0.51, -0.02, 0.13], "joints_rad": []}

The first tracker is kept until it has been silent for ``SILENCE_S``. Poses whose ``t_s`` does not
increase, or increases by more than ``TRACKER_S`` and the time since the last pose, are ignored. A
session of poses that was recorded can be replayed while no tracker sends.
"""

import contextlib
import json
import secrets
import select
import time
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.hardware.radio import opened, sealed, unsealed

SILENCE_S = 0.5
"""Time without a datagram after which either side regards the connection as lost."""
LARGEST = 2048
"""Largest datagram in bytes."""
AHEAD = 25
"""Largest step of the numbers of set-points that arrive within one control period."""
TRACKER_S = 1.0
"""Largest step of a tracker's clock beyond the time that has passed."""
MOST = 256
"""Largest number of datagrams that are processed at once."""


@dataclass(frozen=True)
class Telemetry:
    """State: robot clock ``t_s``, pose (3,), joint angles (J,); NaN if not measured."""

    t_s: float
    pose: Array
    joint: Array
    session: str = ""


@dataclass(frozen=True)
class SetPoints:
    """Desired joint angles, shape (J,); empty with number 0, which starts a swim."""

    number: int
    joint: Array
    session: str = ""


def telemetry_bytes(telemetry: Telemetry, key: bytes | None = None) -> bytes:
    """The robot's datagram, sealed with a key if there is one."""
    content = {"session": telemetry.session, "t_s": round(telemetry.t_s, 9)}
    content |= {"pose": _list(telemetry.pose), "joints_rad": _list(telemetry.joint)}
    return sealed(json.dumps(content).encode(), key)


def set_point_bytes(sent: SetPoints, key: bytes | None = None) -> bytes:
    """The computer's datagram, sealed with a key if there is one."""
    content = {"session": sent.session, "number": sent.number, "joints_rad": _list(sent.joint)}
    return sealed(json.dumps(content).encode(), key)


def read_telemetry(datagram: bytes, J: int, key: bytes | None = None) -> Telemetry | None:
    """Parse the robot's datagram; None if it is not of a robot with J joints and this key."""
    content, session = _object(datagram, key)
    t, pose = _numbers([content.get("t_s")], 1), _numbers(content.get("pose"), 3)
    joint = _numbers(content.get("joints_rad"), J)
    if t is None or pose is None or joint is None or not np.isfinite(t[0]):
        return None
    return Telemetry(float(t[0]), pose, joint, session)


def read_set_points(datagram: bytes, J: int, key: bytes | None = None) -> SetPoints | None:
    """Parse the computer's datagram; None if it is not for a robot with J joints and this key."""
    content, session = _object(datagram, key)
    number = content.get("number")
    if type(number) is not int or number < 0:
        return None
    joint = _numbers(content.get("joints_rad"), J if number else 0)
    if joint is None or not np.isfinite(joint).all():
        return None
    return SetPoints(number, joint, session)


def _list(values: Array) -> list[float | None]:
    return [round(float(x), 9) if np.isfinite(x) else None for x in values]


def _object(datagram: bytes, key: bytes | None) -> tuple[dict[str, object], str]:
    """The content of a datagram and its session; empty if it is none."""
    try:
        content = json.loads(unsealed(datagram, key) or b"")
    except (ValueError, RecursionError):
        return {}, ""
    session = content.get("session", "") if isinstance(content, dict) else None
    if not isinstance(session, str) or not session.isascii() or len(session) > 64:
        return {}, ""
    return content, session


def _numbers(values: object, count: int) -> Array | None:
    """An array of ``count`` numbers, NaN for null; None if ``values`` is anything else."""
    if not isinstance(values, list) or len(values) != count:
        return None
    if not all(value is None or type(value) in (int, float) for value in values):
        return None
    with contextlib.suppress(OverflowError):
        return np.array([np.nan if x is None else x for x in values], dtype=np.float64)
    return None


class Link(contextlib.AbstractContextManager["Link"]):
    """The computer's end, of a robot with J joints; ``strange`` counts unexpected datagrams."""

    def __init__(self, url: str, J: int, key: bytes | None = None) -> None:
        self._J, self._key, self._number, self.strange = J, key, 0, 0
        self._own = self._session = secrets.token_hex(8)
        self._socket = opened(url, "--port", "a robot at udp://HOST:PORT")

    def begin(self) -> None:
        """Ask the robot for its state; it does not move yet. After set-points, a new session."""
        if self._number:
            self._own = self._session = secrets.token_hex(8)
        self._number = 0
        self._send(SetPoints(0, np.empty(0), self._own))

    def send(self, joint: Array) -> None:
        """Send desired angles in rad, shape (J,)."""
        self._number += 1
        self._send(SetPoints(self._number, joint, self._session))

    def _send(self, sent: SetPoints) -> None:
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(set_point_bytes(sent, self._key))

    def receive(self, wait_s: float) -> list[Telemetry]:
        """Wait for telemetry and return all that has arrived; empty after ``wait_s``."""
        deadline, telemetry = time.monotonic() + wait_s, list[Telemetry]()
        while not telemetry and (remaining := deadline - time.monotonic()) > 0:
            if not select.select([self._socket], [], [], remaining)[0]:
                break
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                for _ in range(MOST):
                    message = read_telemetry(self._socket.recv(LARGEST), self._J, self._key)
                    session = "" if message is None else message.session
                    if self._session == self._own and session.startswith(self._own):
                        self._session = session  # which the robot completes in its first answer
                    if message is None or session != self._session:
                        self.strange += 1
                    else:
                        telemetry.append(message)
        return telemetry

    def __exit__(self, *_: object) -> None:
        self._socket.close()
