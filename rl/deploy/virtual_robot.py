"""A virtual robot: the twin with the protocol of ``rl.deploy.link``."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from rl.deploy.link import LARGEST, SILENCE_S, Telemetry, read_set_points, telemetry_bytes
from sim.robot.swimmer import CONTROL_S
from sim.twin.twin import Twin
from sim2real.arrays import Array


class Received:
    """Set-points that a robot has received; in silence it moves to rest.

    Attributes:
        begun: Whether a swim has started.
    """

    def __init__(self, rest: Array) -> None:
        """Start at rest.

        Args:
            rest: Rest angles in rad, shape (J,).
        """
        self.begun = False
        self._rest = rest
        self._desired, self._number, self._silent = rest, 0, 0

    def receive(self, datagram: bytes) -> bool:
        """Process set-points; False if they are invalid or old."""
        sent = read_set_points(datagram, len(self._rest))
        if sent is None or 0 < sent.number <= self._number:
            return False
        self._number, self._silent = sent.number, 0
        if sent.number:
            self._desired = sent.joint
        self.begun = True
        return True

    def next_set_points(self) -> Array:
        """Set-points of the next control period in rad, shape (J,)."""
        self._silent += 1
        if self._silent * CONTROL_S > SILENCE_S:
            self._desired = self._rest
        return self._desired


class Robot(Protocol):
    """A robot's end of the protocol."""

    begun: bool

    def receive(self, datagram: bytes) -> bool:
        """Process set-points; False if they are invalid or old."""

    def advance(self) -> None:
        """Move for one control period."""

    def telemetry(self) -> bytes:
        """The datagram with the state."""


class VirtualRobot(Received):
    """A simulated robot that receives and sends datagrams.

    Attributes:
        twin: Its simulator.
    """

    def __init__(self, twin: Twin) -> None:
        """Start with straight joints at rest.

        Args:
            twin: A twin of one robot.
        """
        limits = np.array([joint.limits_rad for joint in twin.robot.joints])
        super().__init__(np.clip(0.0, *limits.T))
        self.twin = twin

    def advance(self) -> None:
        """Simulate one control period."""
        self.twin.step(self.next_set_points())

    def telemetry(self) -> bytes:
        """The datagram with the state."""
        state = self.twin.state()
        return telemetry_bytes(Telemetry(float(state.time[0]), state.pose[0], state.measured[0]))


def serve(radio: socket.socket, robot: Robot, stop: Callable[[], bool]) -> None:
    """Simulate in real time from the first datagram until ``stop``.

    Telemetry is sent at the start of each period. Set-points apply to the period whose start is
    nearest to their arrival, so that an answer acts without delay, as in training.
    """
    sender: tuple[str, int] | None = None
    begin = time.monotonic()
    while not stop():
        if sender is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                radio.sendto(robot.telemetry(), sender)
        sender = _listen(radio, robot, begin + CONTROL_S / 2) or sender
        if robot.begun:
            robot.advance()
        begin += CONTROL_S
        sender = _listen(radio, robot, begin) or sender


def _listen(radio: socket.socket, robot: Robot, until: float) -> tuple[str, int] | None:
    """Process datagrams until a time; address of the last sender."""
    sender = None
    while select.select([radio], [], [], max(until - time.monotonic(), 0.0))[0]:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            datagram, origin = radio.recvfrom(LARGEST)
            sender = origin if robot.receive(datagram) else sender
    return sender


@contextmanager
def virtual_robot(twin: Twin) -> Iterator[str]:
    """Context manager that runs a robot on loopback; returns its ``udp://HOST:PORT``."""
    twin.step(np.zeros(len(twin.robot.joints)))  # compiles the kernels, so that no period is late
    twin.reset()
    with served(VirtualRobot(twin)) as url:
        yield url


@contextmanager
def served(robot: Robot) -> Iterator[str]:
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
