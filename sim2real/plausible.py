"""Validation of recordings against mistakes of units and columns.

Recordings that are rejected here can only be mistakes; what is merely unusual is a finding of
``check``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.causality import lead_s
from sim2real.clock import check_sampling
from sim2real.errors import InputError
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Joint, Robot, match_joints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlausibleLimits:
    """Limits that recordings of servos exceed only by mistake.

    Attributes:
        range_ratio: Distance of a command from the middle of the joint's range, in half ranges:
            degrees read as radians are 57 times too large.
        speed_ratio: Largest speed relative to the no-load speed of the data sheet, which servos
            may exceed by 50 % at a higher voltage.
        torque_ratio: Largest torque relative to the stall torque of the data sheet, likewise.
        speed_window_s: Time over which a speed is measured.
        torque_window_s: Time over which an acceleration is measured.
        quantile: Quantile of speed and acceleration that is compared, to exclude outliers and end
            stops.
        fewest_samples: With fewer samples speed and torque are not checked.
    """

    range_ratio: float = 6.0
    speed_ratio: float = 4.0
    torque_ratio: float = 6.0
    speed_window_s: float = 0.1
    torque_window_s: float = 0.06
    quantile: float = 0.99
    fewest_samples: int = 20


PLAUSIBLE = PlausibleLimits()
"""The defaults."""


def validate_recording(
    recording: Recording, robot: Robot | None = None, *, limits: PlausibleLimits = PLAUSIBLE
) -> None:
    """Reject a recording whose times, commands or measured angles can only be a mistake.

    Args:
        recording: The recording.
        robot: The robot that was recorded; without it units of angles and loads are not checked.
        limits: Limits of valid values.

    Raises:
        InputError: If the robot lacks a joint, the sampling period is not that of a servo bus, a
            column is both command and position, a joint moves before its command, or angles, speeds
            or torques are many times those that the robot's file states.
    """
    validate_commands(recording, robot, limits=limits)
    for j, joint in enumerate(recording.joints):
        powered = recording.powered(j)
        t, command = recording.t[:powered], recording.command[:powered, j]
        position = recording.position[:powered, j]
        if powered > 1 and recording.kind == "servo":  # joints of a filmed swim may be prescribed
            _check_columns(recording, joint, t, command, position)
        sheet = robot.joint(joint) if robot else None
        if sheet is not None:
            _check_speed(recording, sheet, recording.position[:, j], limits=limits)
            _check_torque(recording, sheet, recording.position[:, j], limits=limits)


def validate_commands(
    recording: Recording, robot: Robot | None = None, *, limits: PlausibleLimits = PLAUSIBLE
) -> None:
    """Reject times and commands that can only be a mistake; measured angles are not checked.

    Args:
        recording: The recording.
        robot: The robot that was recorded; without it only the times are checked.
        limits: Limits of valid values.

    Raises:
        InputError: If the robot lacks a joint, the sampling period is not that of a servo bus, or a
            command is far beyond the joint's limits.
    """
    check_sampling(recording.file, recording.t)
    if robot is None:
        return
    match_joints(recording, robot)
    for j, name in enumerate(recording.joints):
        joint, command = robot.joint(name), recording.command[:, j]
        if joint is None or not joint.states("limits_rad") or not np.isfinite(command).any():
            continue
        low, high = joint.limits_rad
        distance = np.abs(command - (low + high) / 2)
        row = int(np.nanargmax(distance))
        if distance[row] > limits.range_ratio * (high - low) / 2:
            raise InputError(
                recording.file,
                f"{name}.command_rad at {recording.t[row]:.4g} s",
                f"{command[row]:.4g} rad",
                f"angles near the joint's limits_rad of {low:g} to {high:g} (are they degrees, or "
                "are the limits wrong?)",
            )


def _check_columns(
    recording: Recording, joint: str, t: Array, command: Array, position: Array
) -> None:
    measured = np.isfinite(position)
    if (
        measured.sum() > 1
        and np.ptp(command[measured]) > 0
        and np.array_equal(command[measured], position[measured])
    ):
        raise InputError(
            recording.file,
            f"{joint}.command_rad and {joint}.position_rad",
            "the same values in every row",
            "set-points and the angles that were measured (is one column there twice?)",
        )
    lead = lead_s(t, command, position)
    if lead is not None:
        raise InputError(
            recording.file,
            f"{joint}.position_rad",
            f"an angle that moves {lead:.2g} s before its command does",
            f"one that follows {joint}.command_rad (are the two columns swapped, or their clocks "
            "apart?)",
        )


def _check_speed(
    recording: Recording, joint: Joint, position: Array, *, limits: PlausibleLimits
) -> None:
    """Reject angles that change much faster than the servo can turn, such as degrees."""
    if not joint.servo.states("no_load_speed_rad_s"):
        return
    measured = np.isfinite(position)
    if measured.sum() < limits.fewest_samples:
        return
    t, angle = recording.t[measured], position[measured]
    window = _window(t, limits.speed_window_s)
    change = np.abs(
        np.interp(t[t <= t[-1] - window] + window, t, angle) - angle[t <= t[-1] - window]
    )
    stated = joint.servo.no_load_speed_rad_s
    if (
        change.size < limits.fewest_samples
        or np.quantile(change, limits.quantile) <= limits.speed_ratio * stated * window
    ):
        return
    raise InputError(
        recording.file,
        f"{joint.name}.position_rad",
        f"motion at {np.quantile(change, limits.quantile) / window:.3g} rad/s",
        f"at most about the {stated:g} rad/s of no_load_speed_rad_s (are the angles in degrees, "
        "the times in another unit, or is that number wrong?)",
    )


def _check_torque(
    recording: Recording, joint: Joint, position: Array, *, limits: PlausibleLimits
) -> None:
    """Reject a load whose measured acceleration needs far more torque than the servo has.

    The second difference over a window is a weighted mean of the acceleration, so it never exceeds
    the maximum; a part may be due to the weight of a pendulum.
    """
    load = recording.loads.get(joint.name, PER_INERTIA)
    if load is PER_INERTIA or not joint.servo.states("max_torque_Nm"):
        return
    measured = np.isfinite(position)
    if measured.sum() < limits.fewest_samples:
        return
    t, angle = recording.t[measured], position[measured]
    window = _window(t, limits.torque_window_s)
    middle = t[(t >= t[0] + window) & (t <= t[-1] - window)]
    if middle.size < limits.fewest_samples:
        return
    before, mid, after = (np.interp(middle + shift, t, angle) for shift in (-window, 0.0, window))
    acceleration = np.abs(after - 2 * mid + before) / window**2
    usual = float(np.quantile(acceleration, limits.quantile)) - 2 * float(np.median(acceleration))
    torque, stated = load.inertia_kgm2 * usual - load.gravity_Nm, joint.servo.max_torque_Nm
    if torque <= limits.torque_ratio * stated:
        return
    raise InputError(
        recording.file,
        f"loads.{joint.name}.inertia_kgm2",
        f"{load.inertia_kgm2:g} kg m2, which takes {torque:.3g} N m to move as recorded",
        f"an inertia that a servo of max_torque_Nm = {stated:g} can move so (g cm2 instead of "
        "kg m2, perhaps?)",
    )


def _window(t: Array, length_s: float) -> float:
    """A window of ``length_s``, or of two samples where they are further apart."""
    return max(length_s, 2 * float(np.median(np.diff(t))))
