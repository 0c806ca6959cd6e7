"""Findings about one joint of a recording, one sentence each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.recording import Recording
from sim2real.robot import Joint

SLOWEST_EXCITATION_HZ = 0.2
FEWEST_MOVES = 4
LONGEST_LATENCY_S = 0.15
STUCK_S = 0.5


@dataclass(frozen=True)
class _PoweredJoint:
    """One joint of a recording while its torque is on; no command is missing."""

    joint: str
    t: Array
    command: Array
    position: Array
    noise_rad: float
    step_rad: float


def moves(t: Array, command: Array) -> int:
    """Number of movements of ``command`` (T,): reversals, and starts after 0.1 s or more."""
    changed = np.flatnonzero(np.diff(command)) + 1
    if not changed.size:
        return 0
    turned = np.diff(np.sign(command[changed] - command[changed - 1])) != 0
    pause = np.diff(t[changed]) > max(0.1, 2.5 * np.median(np.diff(t)))
    return 1 + int(np.sum(turned | pause))


def joint_findings(
    recording: Recording, j: int, noise_rad: float, step_rad: float, sheet: Joint | None
) -> Iterator[str]:
    """Findings about one joint, including what its load does not allow to identify.

    Args:
        recording: The recording.
        j: Number of the joint in it.
        noise_rad: Standard deviation of the measurement noise.
        step_rad: Quantization step; 0 if there is none.
        sheet: The joint in the robot's description.
    """
    powered = recording.powered(j)
    if powered < 2:
        return
    t, command = recording.t[:powered], recording.command[:powered, j]
    position = recording.position[:powered, j]
    data = _PoweredJoint(recording.joints[j], t, command, position, noise_rad, step_rad)
    finite = np.isfinite(data.position)
    if not finite.any():
        yield f"{data.joint} has no measured positions."
        return
    missing = float(np.mean(~finite))
    if missing > 0.01:
        yield f"{data.joint} lacks {100 * missing:.2g} % of its positions."
    span, least = float(np.ptp(data.command)), max(2 * data.step_rad, 9 * data.noise_rad)
    if span <= max(2 * data.step_rad, 1e-4):
        yield f"{data.joint} is never commanded to move: nothing can be fitted to it."
    elif float(np.ptp(data.position[finite])) <= min(least, 0.5 * span):
        yield f"{data.joint} does not move, although its command spans {span:.3g} rad."
    else:
        yield from _motion(data, finite)
    yield from _start(data, finite)
    yield from _excitation(data)
    if sheet is not None:
        yield from _data_sheet(data, sheet)
    if powered < recording.t.size:
        yield f"{data.joint}'s torque is off from {recording.t[powered]:.4g} s on."
    if recording.kind != "servo":
        return
    load = recording.loads.get(data.joint)
    if load is None:
        yield f"{data.joint} has no stated load: its gains are identified per unit of inertia."
    elif not load.gravity_Nm:
        yield (
            f"{data.joint}'s load has no pendulum: only kp/inertia and kd/inertia are "
            "identifiable, so the stated inertia cannot be checked."
        )


def _motion(data: _PoweredJoint, finite: Mask) -> Iterator[str]:
    t, command, position = data.t[finite], data.command[finite], data.position[finite]
    edges = np.flatnonzero(np.r_[True, np.diff(position) != 0, True])
    for a, b in zip(edges[:-1], edges[1:] - 1, strict=True):
        # Commands at the end of the interval have not taken effect yet.
        due = command[a : b + 1][t[a : b + 1] < t[b] - 2 * LONGEST_LATENCY_S]
        moved = float(np.ptp(due)) if due.size else 0.0
        if t[b] - t[a] > STUCK_S and moved > max(0.1, 10 * data.step_rad):
            yield (
                f"{data.joint} reads exactly {position[a]:.4g} rad from {t[a]:.4g} to {t[b]:.4g} s "
                f"while its command moves by {moved:.2g} rad: friction, gears or sensor may be "
                "stuck."
            )
            return
    largest = max(1, int(LONGEST_LATENCY_S / np.median(np.diff(t)))) if t.size > 2 else 0
    lags = range(min(largest, t.size - 3) + 1)
    match = [_correlation(command[: t.size - k], position[k:]) for k in lags]
    if match and max(match) < 0 and min(match) < -0.5:
        yield (
            f"{data.joint} moves against its command (correlation {min(match):.2f}): the sign of "
            "one of them is reversed."
        )


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    return float(np.sum(a * b)) / size if size > 0 else 0.0


def _start(data: _PoweredJoint, finite: Mask) -> Iterator[str]:
    changed = np.flatnonzero(data.command != data.command[0])
    still = int(changed[0]) + 1 if changed.size else data.t.size  # the change itself comes later
    early = np.flatnonzero(finite[:still] & (data.t[:still] <= data.t[0] + 0.5))
    if not early.size:
        return
    offset = float(np.median(data.position[early] - data.command[0]))
    if float(np.ptp(data.position[early])) > max(5 * data.step_rad, 9 * data.noise_rad, 0.01):
        yield f"{data.joint} is moving at the start of the recording: it should be at rest."
    elif abs(offset) > 0.1:
        yield f"{data.joint} starts {abs(offset):.2g} rad away from its first command."
    elif abs(offset) > max(3 * data.step_rad, 4 * data.noise_rad, 0.005):
        side = "above" if offset > 0 else "below"
        yield (
            f"{data.joint} starts at rest {abs(offset):.2g} rad {side} its command: there may "
            "be an offset, a load or a dead band."
        )


def _excitation(data: _PoweredJoint) -> Iterator[str]:
    count = moves(data.t, data.command)
    if not count:
        return
    if count < FEWEST_MOVES:
        times = ("once", "twice", "three times")[count - 1]
        yield (
            f"{data.joint} is commanded to move only {times}: too little to hold out for "
            "validation."
        )
    step = np.diff(data.t)
    spread = float(np.average((data.command[1:] - data.command.mean()) ** 2, weights=step))
    speed = float(np.average((np.diff(data.command) / step) ** 2, weights=step))
    frequency = float(np.sqrt(speed / spread)) / (2 * np.pi)  # exact for a sine
    if frequency < SLOWEST_EXCITATION_HZ:
        yield (
            f"{data.joint} is moved very slowly (about {frequency:.2g} Hz): damping, latency and "
            "inertia are hardly identifiable."
        )


def _data_sheet(data: _PoweredJoint, sheet: Joint) -> Iterator[str]:
    if sheet.states("limits_rad"):
        yield from _limits(data, *sheet.limits_rad)
    changed = np.flatnonzero(np.diff(data.command)) + 1
    slope = np.abs(np.diff(data.command[changed]) / np.diff(data.t[changed]))
    # Two slopes in a row: one alone may be a step, which no servo follows.
    fastest = float(np.minimum(slope[1:], slope[:-1]).max()) if slope.size > 1 else 0.0
    servo = sheet.servo
    if servo.states("no_load_speed_rad_s") and fastest > servo.no_load_speed_rad_s:
        yield (
            f"{data.joint} is commanded at up to {fastest:.3g} rad/s, above its servo's no-load "
            f"speed of {servo.no_load_speed_rad_s:.3g} rad/s: the response will be limited by it."
        )
    stated = servo.position_step_rad if servo.states("position_step_rad") else 0.0
    counts = data.step_rad / stated if stated > 0 else 0.0
    if counts and abs(counts - round(counts)) > 0.05:
        yield (
            f"{data.joint} is measured in steps of {data.step_rad:.3g} rad, but the data sheet "
            f"states {stated:.3g} rad."
        )


def _limits(data: _PoweredJoint, low: float, high: float) -> Iterator[str]:
    extremes = (float(data.command.min()), float(data.command.max()))
    if extremes[0] < low - 1e-6 or extremes[1] > high + 1e-6:
        beyond = extremes[1] if extremes[1] > high + 1e-6 else extremes[0]
        yield (
            f"{data.joint} is commanded to {beyond:.3g} rad, beyond its limits of {low:.3g} to "
            f"{high:.3g} rad."
        )
