"""A robot whose servos are on a bus of this computer, with the protocol of ``rl.deploy.link``.

Its pose comes from a tracker, in UDP datagrams whose format is described there.
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from rl.deploy.link import LARGEST, MOST, SILENCE_S, TRACKER_S, Telemetry, opened, read_telemetry
from rl.deploy.virtual_robot import Received, served
from rl.observer import CONTROL_S
from sim2real.arrays import Array
from sim2real.hardware.buses import Connection
from sim2real.hardware.mounting import Mounting
from sim2real.hardware.servo_bus import ServoBus, Stopped, reason
from sim2real.hardware.session import approach, let_go, note_changes

CYCLE_S = 0.4 * CONTROL_S
"""Longest round over the bus: set-points are awaited in the rest of a period."""


class Poses:
    """Poses of the first tracker that sends, until it falls silent.

    Args:
        listener: The socket where they arrive, which does not block.
        key: Key that the tracker shares; none by default.
    """

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
                if seen is not None and self._accept(seen, sender):
                    pose = seen.pose
        return pose

    def _accept(self, seen: Telemetry, sender: object) -> bool:
        """Whether a pose is of the present tracker and new, or of the first one."""
        now, tracker = time.monotonic(), (sender, seen.session)
        passed = now - self._heard
        if tracker != self._tracker:
            if self._tracker is not None and passed <= SILENCE_S:
                return False
        elif not 0 < seen.t_s - self._t <= passed + TRACKER_S:
            return False
        self._tracker, self._t, self._heard = tracker, seen.t_s, now
        return True


class BusRobot(Received):
    """Servos on a bus, and the pose that a tracker sends; see ``bus_robot`` for the arguments.

    Attributes:
        stopped: Why the servos are not driven any further; None while they are.
    """

    def __init__(
        self,
        bus: ServoBus,
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
        try:
            self._joint = self._round(self.next_set_points())
        except (Stopped, OSError) as error:
            self.stopped = reason(error)

    def measured(self) -> tuple[float, Array, Array]:
        """See ``Received``; the pose is missing if none has arrived since the last call."""
        joint = self._joint if self.stopped is None else np.full(len(self._joint), np.nan)
        return time.monotonic(), self._poses.newest(), joint

    def _round(self, desired: Array) -> Array:
        pairs = list(zip(self._mountings, desired, strict=True))
        goals = {mounting.servo_id: mounting.ticks(float(angle)) for mounting, angle in pairs}
        cycle = self._bus.cycle(goals, time.monotonic() + CYCLE_S)
        angles = []
        for mounting, reading in zip(self._mountings, cycle.readings, strict=True):
            mounting.check_temperature(reading.temperature_C, self._hottest_C)
            ticks = reading.position_ticks
            angles.append(math.nan if ticks is None else mounting.angle(ticks))
        return np.array(angles)


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
    """Context manager that moves the servos to rest and serves them on loopback.

    In the end they are released, and what was changed in them is restored.

    Args:
        connection: The bus.
        mountings: The J servos.
        rest: Rest angles in rad, shape (J,).
        poses: ``udp://HOST:PORT`` of this computer, to which the tracker sends poses; only from
            this computer if HOST is missing.
        hottest_C: Temperature at which to stop.
        interrupted: Whether the user has asked to stop.
        key: Key of the link and of the tracker; none by default.

    Returns:
        The robot's ``udp://HOST:PORT``, and the robot.

    Raises:
        Stopped: If a servo does not answer, is too hot or cannot be released.
        InputError: If the address for poses is invalid or in use.
    """
    expected = "udp://HOST:PORT of this computer, where poses arrive"
    with opened(poses, "--pose", expected, bind=True) as listener:
        changed = note_changes(connection, mountings)
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
            held = let_go(connection, mountings, changed)
        if held:
            names = ", ".join(mounting.joint.name for mounting in held)
            raise Stopped(f"the torque of {names} may still be on: switch off the supply")
