"""A robot whose servos are on a bus of this computer, with the protocol of ``rl.deploy.link``.

Its pose comes in UDP datagrams from a tracker, one JSON object each, as of a robot without joints::

    {"t_s": 12.34, "pose": [0.51, -0.02, 0.13], "joints_rad": []}
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np

from rl.deploy.link import LARGEST, Telemetry, read_telemetry, telemetry_bytes
from rl.deploy.measurements import CONTROL_S
from rl.deploy.virtual_robot import Received, served
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.hardware.buses import Connection
from sim2real.hardware.motion import approach, check_temperature
from sim2real.hardware.mounting import Mounting
from sim2real.hardware.servo_bus import ServoBus, Stopped
from sim2real.hardware.session import let_go, note_changes

CYCLE_S = 0.4 * CONTROL_S
"""Longest round over the bus: set-points are awaited in the rest of a period."""


class BusRobot(Received):
    """Servos on a bus, and the pose that a tracker sends.

    Attributes:
        stopped: Why the servos are not driven any further; None while they are.
    """

    def __init__(
        self,
        bus: ServoBus,
        mountings: Sequence[Mounting],
        rest: Array,
        poses: socket.socket,
        *,
        hottest_C: float,
    ) -> None:
        """Start at rest.

        Args:
            bus: The bus, on which the servos hold their rest angles.
            mountings: The J servos.
            rest: Rest angles in rad, shape (J,).
            poses: Socket at which poses arrive.
            hottest_C: Temperature at which to stop.
        """
        super().__init__(rest)
        self.stopped: str | None = None
        self._bus, self._mountings, self._hottest_C = bus, mountings, hottest_C
        self._poses, self._joint = poses, np.full(len(mountings), np.nan)

    def advance(self) -> None:
        """Send the set-points of one control period and read the angles."""
        if self.stopped is not None:
            return
        desired = self.next_set_points()
        try:
            self._joint = self._round(desired)
        except Stopped as stop:
            self.stopped = str(stop)
        except OSError as error:
            self.stopped = f"the port was lost ({error.strerror or error})"

    def telemetry(self) -> bytes:
        """The datagram with the state; the pose is missing if none has arrived since the last."""
        joint = self._joint if self.stopped is None else np.full(len(self._joint), np.nan)
        return telemetry_bytes(Telemetry(time.monotonic(), self._pose(), joint))

    def _round(self, desired: Array) -> Array:
        pairs = list(zip(self._mountings, desired, strict=True))
        goals = {mounting.servo_id: mounting.ticks(float(angle)) for mounting, angle in pairs}
        cycle = self._bus.cycle(goals, time.monotonic() + CYCLE_S)
        angles = []
        for mounting, reading in zip(self._mountings, cycle.readings, strict=True):
            if not math.isnan(reading.temperature_C):
                check_temperature(mounting, reading.temperature_C, self._hottest_C)
            ticks = reading.position_ticks
            angles.append(math.nan if ticks is None else mounting.angle(ticks))
        return np.array(angles)

    def _pose(self) -> Array:
        pose = np.full(3, np.nan)
        with contextlib.suppress(BlockingIOError):
            while True:
                telemetry = read_telemetry(self._poses.recv(LARGEST), 0)
                pose = pose if telemetry is None else telemetry.pose
        return pose


@contextmanager
def bus_robot(
    connection: Connection,
    mountings: Sequence[Mounting],
    rest: Array,
    poses: str,
    *,
    hottest_C: float,
    interrupted: Callable[[], bool],
) -> Iterator[tuple[str, BusRobot]]:
    """Context manager that moves the servos to rest and serves them on loopback.

    In the end they are released, and what was changed in them is restored.

    Args:
        connection: The bus.
        mountings: The J servos.
        rest: Rest angles in rad, shape (J,).
        poses: ``udp://HOST:PORT`` of this computer, to which the tracker sends poses.
        hottest_C: Temperature at which to stop.
        interrupted: Whether the user has asked to stop.

    Returns:
        The robot's ``udp://HOST:PORT``, and the robot.

    Raises:
        Stopped: If a servo does not answer, is too hot or cannot be released.
        InputError: If the address for poses is invalid or in use.
    """
    with _listening(poses) as listener:
        changed = note_changes(connection, mountings)
        try:
            approach(
                connection.bus,
                mountings,
                [float(angle) for angle in rest],
                hottest_C=hottest_C,
                interrupted=interrupted,
            )
            robot = BusRobot(connection.bus, mountings, rest, listener, hottest_C=hottest_C)
            with served(robot) as url:
                yield url, robot
        finally:
            held = let_go(connection, mountings, changed)
        if held:
            names = ", ".join(mounting.joint.name for mounting in held)
            raise Stopped(f"the torque of {names} may still be on: switch off the supply")


def _listening(url: str) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        address = urlsplit(url)
        if address.scheme != "udp":
            raise ValueError("not udp")
        listener.bind((address.hostname or "", address.port or 0))
    except (OSError, ValueError, UnicodeError, OverflowError) as error:
        listener.close()
        expected = "udp://HOST:PORT of this computer, where poses arrive"
        raise InputError("--pose", "", f"{url!r} ({error})", expected) from None
    listener.setblocking(False)
    return listener
