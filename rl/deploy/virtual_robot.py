"""A robot's end of the protocol of ``rl.deploy.link``; a virtual robot: the twin with it."""

from __future__ import annotations

import contextlib
import hmac
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from rl.deploy.link import (
    AHEAD,
    LARGEST,
    MOST,
    SILENCE_S,
    Telemetry,
    read_set_points,
    telemetry_bytes,
)
from rl.observer import CONTROL_S
from sim.twin.twin import Twin
from sim2real.arrays import Array


class Received:
    """A robot that receives set-points from one sender; in silence it moves to rest.

    Attributes:
        begun: Whether a swim has started.
        session: Identifier of the present or last session; empty before the first.
        sender: Address of its computer.
    """

    def __init__(self, rest: Array, limits: Array, key: bytes | None = None) -> None:
        """Start at rest.

        Args:
            rest: Rest angles in rad, shape (J,).
            limits: Lowest and highest angle of each joint in rad, shape (J, 2).
            key: Key that the computer shares; none by default.
        """
        self.begun, self.session, self._asked = False, "", ""
        self.sender: tuple[str, int] | None = None
        self._rest, self._limits, self._key = rest, limits, key
        self._desired, self._number, self._silent = rest, 0, 0

    def advance(self) -> None:
        """Move for one control period."""
        raise NotImplementedError

    def measured(self) -> tuple[float, Array, Array]:
        """The robot's clock in s, pose (3,) and joint angles (J,)."""
        raise NotImplementedError

    def telemetry(self) -> bytes:
        """The datagram with the state."""
        return telemetry_bytes(Telemetry(*self.measured(), self.session), self._key)

    @property
    def held(self) -> bool:
        """Whether a computer has the robot: it has been heard within ``SILENCE_S``."""
        return bool(self.session) and self._silent * CONTROL_S <= SILENCE_S

    def receive(self, datagram: bytes, sender: tuple[str, int] | None = None) -> bool:
        """Process set-points from an address; False if they are invalid, old or a stranger's."""
        sent = read_set_points(datagram, len(self._rest), self._key)
        if sent is None:
            return False
        if sent.number == 0:
            return self._begin(sent.session, sender)
        step = sent.number - self._number
        ours = sender == self.sender and hmac.compare_digest(sent.session, self.session)
        if not self.session or not ours or not 0 < step <= AHEAD + self._silent:
            return False
        self._number, self._silent = sent.number, 0
        self._desired = np.clip(sent.joint, *self._limits.T)
        return True

    def _begin(self, session: str, sender: tuple[str, int] | None) -> bool:
        """Start a session unless a computer has the robot; True also for its repeated request."""
        if self.held:
            return (session, sender, 0) == (self._asked, self.sender, self._number)
        self._asked, self.sender = session, sender
        self.session = session + secrets.token_hex(8)
        self._number, self._silent, self.begun = 0, 0, True
        return True

    def next_set_points(self) -> Array:
        """Set-points of the next control period in rad, shape (J,)."""
        self._silent += 1
        if self._silent * CONTROL_S > SILENCE_S:
            self._desired = self._rest
        return self._desired


class VirtualRobot(Received):
    """A twin of one robot that receives and sends datagrams; it starts straight and at rest."""

    def __init__(self, twin: Twin, key: bytes | None = None) -> None:
        limits = np.array([joint.limits_rad for joint in twin.robot.joints])
        super().__init__(np.clip(0.0, *limits.T), limits, key)
        self.twin = twin

    def advance(self) -> None:
        """Simulate one control period."""
        self.twin.step(self.next_set_points())

    def measured(self) -> tuple[float, Array, Array]:
        """See ``Received``."""
        state = self.twin.state()
        return float(state.time[0]), state.pose[0], state.measured[0]


def serve(radio: socket.socket, robot: Received, stop: Callable[[], bool]) -> None:
    """Run a robot in real time from the first datagram until ``stop``.

    Telemetry is sent to the robot's computer at the start of each period. Set-points apply to the
    period whose start is nearest to their arrival, so that an answer acts without delay, as in
    training.
    """
    begin = time.monotonic()
    while not stop():
        if robot.held and robot.sender is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                radio.sendto(robot.telemetry(), robot.sender)
        _listen(radio, robot, begin + CONTROL_S / 2)
        if robot.begun:
            robot.advance()
        begin += CONTROL_S
        _listen(radio, robot, begin)


def _listen(radio: socket.socket, robot: Received, until: float) -> None:
    """Process datagrams until a time, at most ``MOST``, so that a flood cannot stop the robot."""
    for _ in range(MOST):
        if not select.select([radio], [], [], max(until - time.monotonic(), 0.0))[0]:
            return
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            robot.receive(*radio.recvfrom(LARGEST))
    time.sleep(max(until - time.monotonic(), 0.0))


@contextmanager
def virtual_robot(twin: Twin, key: bytes | None = None) -> Iterator[str]:
    """Context manager that runs a robot on loopback; returns its ``udp://HOST:PORT``."""
    twin.step(np.zeros(len(twin.robot.joints)))  # compiles the kernels, so that no period is late
    twin.reset()
    with served(VirtualRobot(twin, key)) as url:
        yield url


@contextmanager
def served(robot: Received) -> Iterator[str]:
    """Context manager that serves a robot on loopback; returns its ``udp://HOST:PORT``."""
    stop = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        radio.setblocking(False)
        radio.bind(("127.0.0.1", 0))
        host, port = radio.getsockname()
        thread = threading.Thread(target=serve, args=(radio, robot, stop.is_set), daemon=True)
        thread.start()
        try:
            yield f"udp://{host}:{port}"
        finally:
            stop.set()
            thread.join()
