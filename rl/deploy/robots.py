"""A robot's end of the protocol of ``rl.deploy.link``: the twin, or servos on a bus."""

from __future__ import annotations

import contextlib
import hmac
import math
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from rl.deploy.link import (
    AHEAD,
    LARGEST,
    MOST,
    SILENCE_S,
    TRACKER_S,
    Telemetry,
    read_set_points,
    read_telemetry,
    telemetry_bytes,
)
from rl.observer import CONTROL_S
from sim2real.arrays import Array
from sim2real.hardware.mounting import Mounting
from sim2real.hardware.radio import opened
from sim2real.hardware.recorder import approach
from sim2real.hardware.servo_bus import Stopped, reason

if TYPE_CHECKING:
    from sim.twin.twin import Twin
    from sim2real.hardware.buses import Bus, Connection


class Received:
    """A robot that receives set-points from one sender; in silence it moves to rest."""

    def __init__(self, rest: Array, limits: Array, key: bytes | None = None) -> None:
        """Start at rest angles (J,), with the joints' limits (J, 2) in rad and a shared key."""
        self.session = ""
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
        """Process set-points from an address; False if they are invalid, old or a stranger's.

        Number 0 starts a session unless a computer has the robot.
        """
        sent = read_set_points(datagram, len(self._rest), self._key)
        if sent is None:
            return False
        if sent.number == 0 and self.held:  # True for the repeated request of its computer
            return (sent.session, sender, 0) == (self.session[:-16], self.sender, self._number)
        if sent.number == 0:
            self.session, self.sender = sent.session + secrets.token_hex(8), sender
            self._number, self._silent = 0, 0
            return True
        step = sent.number - self._number
        ours = sender == self.sender and hmac.compare_digest(sent.session, self.session)
        if not self.session or not ours or not 0 < step <= AHEAD + self._silent:
            return False
        self._number, self._silent = sent.number, 0
        self._desired = np.clip(sent.joint, *self._limits.T)
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
    """Run a robot in real time; a set-point applies to the period whose start is nearest."""
    begin = time.monotonic()
    while not stop():
        if robot.held and robot.sender is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                radio.sendto(robot.telemetry(), robot.sender)
        _listen(radio, robot, begin + CONTROL_S / 2)
        if robot.session:
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


class Poses:
    """Poses of the first tracker that sends to ``listener``, until it falls silent."""

    def __init__(self, listener: socket.socket, key: bytes | None = None) -> None:
        self._listener, self._key = listener, key
        self._tracker: tuple[object, str] | None = None
        self._t, self._heard = 0.0, 0.0

    def newest(self) -> Array:
        """x, y, heading, shape (3,); NaN if no pose has arrived since the last call."""
        pose = np.full(3, np.nan)
        with contextlib.suppress(BlockingIOError):
            for _ in range(MOST):
                datagram, sender = self._listener.recvfrom(LARGEST)
                seen = read_telemetry(datagram, 0, self._key)
                if seen is None:
                    continue
                now, tracker = time.monotonic(), (sender, seen.session)
                passed = now - self._heard
                if tracker == self._tracker:
                    accepted = 0 < seen.t_s - self._t <= passed + TRACKER_S
                else:
                    accepted = self._tracker is None or passed > SILENCE_S
                if accepted:
                    self._tracker, self._t, self._heard = tracker, seen.t_s, now
                    pose = seen.pose
        return pose


class BusRobot(Received):
    """Servos on a bus, and the pose that a tracker sends; see ``bus_robot`` for the arguments."""

    def __init__(
        self,
        bus: Bus,
        mountings: Sequence[Mounting],
        rest: Array,
        poses: Poses,
        hottest_C: float,
        key: bytes | None,
    ) -> None:
        limits = np.array([mounting.joint.limits_rad for mounting in mountings])
        super().__init__(rest, limits, key)
        self.stopped: str | None = None
        self._bus, self._mountings, self._hottest_C = bus, mountings, hottest_C
        self._poses, self._joint = poses, np.full(len(mountings), np.nan)

    def advance(self) -> None:
        """Send the set-points of one control period and read the angles."""
        if self.stopped is not None:
            return
        pairs = list(zip(self._mountings, self.next_set_points(), strict=True))
        try:
            goals = {mounting.servo_id: mounting.ticks(float(angle)) for mounting, angle in pairs}
            # set-points are awaited in the rest of the period
            cycle = self._bus.cycle(goals, time.monotonic() + 0.4 * CONTROL_S)
            angles = []
            for mounting, reading in zip(self._mountings, cycle.readings, strict=True):
                mounting.check_temperature(reading.temperature_C, self._hottest_C)
                ticks = reading.position_ticks
                angles.append(math.nan if ticks is None else mounting.angle(ticks))
            self._joint = np.array(angles)
        except (Stopped, OSError) as error:
            self.stopped = reason(error)

    def measured(self) -> tuple[float, Array, Array]:
        """See ``Received``; the pose is missing if none has arrived since the last call."""
        joint = self._joint if self.stopped is None else np.full(len(self._joint), np.nan)
        return time.monotonic(), self._poses.newest(), joint


@contextmanager
def bus_robot(
    connection: Connection,
    mountings: Sequence[Mounting],
    rest: Array,
    poses: str,
    *,
    hottest_C: float,
    interrupted: Callable[[], bool],
    key: bytes | None = None,
) -> Iterator[tuple[str, BusRobot]]:
    """Context manager that moves the servos to rest and serves them; returns URL and robot.

    In the end they are released, and what was changed in them is restored, or ``Stopped`` raised.
    The tracker sends to ``poses``, ``udp://HOST:PORT`` of this computer, with the ``key`` of the
    link.
    """
    expected = "udp://HOST:PORT of this computer, where poses arrive"
    with opened(poses, "--pose", expected, bind=True) as listener:
        ids = [mounting.servo_id for mounting in mountings]
        changed = connection.note(ids)
        try:
            approach(
                connection.bus, mountings, [float(angle) for angle in rest],
                hottest_C=hottest_C, interrupted=interrupted,
            )  # fmt: skip
            seen = Poses(listener, key)
            robot = BusRobot(connection.bus, mountings, rest, seen, hottest_C, key)
            with served(robot) as url:
                yield url, robot
        finally:
            held = connection.release(changed, ids)
        if held:
            names = ", ".join(m.joint.name for m in mountings if m.servo_id in held)
            raise Stopped(f"the torque of {names} may still be on: switch off the supply")
