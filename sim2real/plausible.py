"""What of recordings may be fitted: mistakes of units and columns are rejected.

Recordings that are rejected here can only be mistakes; what is merely unusual is a finding of
``check``.
"""

from collections.abc import Iterable

import numpy as np

from sim2real.arrays import Array
from sim2real.clock import check_sampling
from sim2real.errors import InputError
from sim2real.findings import joint_rows, merged, recording_findings
from sim2real.readings import lead_s, wrong_readings
from sim2real.recording import Recording
from sim2real.robot import Joint, Robot, match_joints

_QUANTILE = 0.99
"""Quantile of speed and acceleration that is compared, to exclude outliers and end stops."""
_FEWEST_SAMPLES = 20
"""With fewer samples speed and torque are not checked."""


def admitted(
    recordings: Iterable[Recording], robot: Robot | None = None
) -> tuple[list[Recording], tuple[str, ...]]:
    """What of recordings may be fitted, and warnings about them, with the recordings' names.

    Joints with errors are left out of a recording on a bench where others remain that move; an
    InputError if none does. Without the robot units of angles and loads are not checked.
    """
    kept, where = [], dict[str, list[str]]()
    for recording in recordings:
        validate_recording(recording, robot)
        rows = [*joint_rows(recording, robot)]
        wrong = {joint: found for joint, found in reversed(rows) if found.severity == "error"}
        others = [j for j in recording.joints if j not in wrong and recording.moves(j)]
        if wrong and (not others or recording.kind != "servo"):
            first = wrong[next(joint for joint, found in rows if found.severity == "error")]
            raise InputError(recording.file, first.where, first.found, first.expected)
        kept.append(recording.without(wrong))
        for finding in (*recording_findings(recording), *merged(rows)):
            if finding.severity != "note":
                left_out = " It is left out." if finding.severity == "error" else ""
                where.setdefault(finding.text + left_out, []).append(recording.name)
    texts = (f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in where.items())
    return kept, tuple(texts)


def validate_recording(recording: Recording, robot: Robot | None = None) -> None:
    """Reject a recording whose times, commands or measured angles can only be a mistake."""
    validate_commands(recording, robot)
    for j, joint in enumerate(recording.joints):
        if recording.kind == "servo":  # joints of a filmed swim may be prescribed
            _check_columns(recording, j)
        sheet = robot.joint(joint) if robot else None
        measured = np.isfinite(recording.position[:, j])
        if sheet is not None and measured.sum() >= _FEWEST_SAMPLES:
            t, angle = recording.t[measured], recording.position[measured, j]
            _check_speed(recording.file, sheet, t, angle)
            _check_torque(recording, sheet, t, angle)


def validate_commands(recording: Recording, robot: Robot | None = None) -> None:
    """Reject times and commands that can only be a mistake, such as degrees read as radians."""
    check_sampling(recording.file, recording.t)
    if robot is None:
        return
    match_joints(recording, robot)
    for name, command in recording.commands.items():
        joint = robot.joint(name)
        if joint is None or not joint.states("limits_rad") or not np.isfinite(command).any():
            continue
        low, high = joint.limits_rad
        distance = np.abs(command - (low + high) / 2)
        row = int(np.nanargmax(distance))
        if distance[row] > 6 * (high - low) / 2:
            where = f"{name}.command_rad at {recording.t[row]:.4g} s"
            expected = f"angles near the joint's limits_rad of {low:g} to {high:g}"
            hint = "(are they degrees, or are the limits wrong?)"
            found = f"{command[row]:.4g} rad"
            raise InputError(recording.file, where, found, f"{expected} {hint}")


def _check_columns(recording: Recording, j: int) -> None:
    """Reject a position that repeats or precedes its command."""
    joint, powered = recording.joints[j], recording.powered(j)
    if powered < 2:
        return
    columns = recording.t, recording.command[:, j], recording.position[:, j]
    t, command, position = (x[:powered] for x in columns)
    measured = np.isfinite(position)
    sent = command[measured]
    if sent.size > 1 and np.ptp(sent) > 0 and np.array_equal(sent, position[measured]):
        raise InputError(
            recording.file,
            f"{joint}.command_rad and {joint}.position_rad",
            "the same values in every row",
            "set-points and the angles that were measured (is one column there twice?)",
        )
    lead = lead_s(t, command, np.where(wrong_readings(position), np.nan, position))
    if lead is not None:
        found = f"an angle that moves {lead:.2g} s before its command does"
        hint = "(are the two columns swapped, or their clocks apart?)"
        expected = f"one that follows {joint}.command_rad {hint}"
        raise InputError(recording.file, f"{joint}.position_rad", found, expected)


def _check_speed(file: str, joint: Joint, t: Array, angle: Array) -> None:
    """Reject angles whose speed over 0.1 s is far above the data sheet's, such as degrees."""
    window = max(0.1, 2 * float(np.median(np.diff(t))))
    early = t <= t[-1] - window
    if not joint.servo.states("no_load_speed_rad_s") or early.sum() < _FEWEST_SAMPLES:
        return
    change = np.abs(np.interp(t[early] + window, t, angle) - angle[early])
    stated, speed = joint.servo.no_load_speed_rad_s, np.quantile(change, _QUANTILE) / window
    if speed > 4 * stated:
        hint = "(are the angles in degrees, the times in another unit, or is that number wrong?)"
        expected = f"at most about the {stated:g} rad/s of no_load_speed_rad_s {hint}"
        where, found = f"{joint.name}.position_rad", f"motion at {speed:.3g} rad/s"
        raise InputError(file, where, found, expected)


def _check_torque(recording: Recording, joint: Joint, t: Array, angle: Array) -> None:
    """Reject a load whose acceleration over 0.06 s needs far more torque than the servo has."""
    load, window = recording.loads.get(joint.name), max(0.06, 2 * float(np.median(np.diff(t))))
    middle = t[(t >= t[0] + window) & (t <= t[-1] - window)]
    if load is None or not joint.servo.states("max_torque_Nm") or middle.size < _FEWEST_SAMPLES:
        return
    before, mid, after = (np.interp(middle + shift, t, angle) for shift in (-window, 0.0, window))
    acceleration = np.abs(after - 2 * mid + before) / window**2
    usual = float(np.quantile(acceleration, _QUANTILE)) - 2 * float(np.median(acceleration))
    torque, stated = load.inertia_kgm2 * usual - load.gravity_Nm, joint.servo.max_torque_Nm
    if torque > 6 * stated:
        found = f"{load.inertia_kgm2:g} kg m2, which takes {torque:.3g} N m to move as recorded"
        expected = f"an inertia that a servo of max_torque_Nm = {stated:g} can move so"
        hint = "(g cm2 instead of kg m2, perhaps?)"
        where = f"loads.{joint.name}.inertia_kgm2"
        raise InputError(recording.file, where, found, f"{expected} {hint}")
