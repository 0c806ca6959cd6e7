"""Traces: one joint of one recording, prepared for a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.errors import InputError
from sim2real.inference.correlated_noise import counting, lags
from sim2real.noise import noise_floor, quantization_step
from sim2real.recording import PER_INERTIA, Load, Recording

_FULL, _NEARLY_FULL, _ROUNDING = 1.0, 0.95, 0.01
_FEWEST, _PROPORTIONAL = 50, 0.02
"""Fewest samples of a drive; largest share of its power that the error does not explain."""

FEWEST_SAMPLES = 20
"""Smallest number of measured angles for a fit."""
FINEST_NOISE_RAD = 1e-6
"""Smallest noise: recordings are written with six decimals."""

HELD_OUT_SHARE = 0.25
"""Share of a single recording, at its end, that is held out."""


@dataclass(frozen=True)
class Trace:
    """Commands and measured angles of one joint, while its torque was on.

    Attributes:
        name: Name of the recording.
        file: File of the recording, unique among recordings.
        t: Times in s, shape (T,).
        command: Set-points in rad, shape (T,).
        position: Measured angles in rad, shape (T,), NaN where missing.
        load: The stated load, or ``PER_INERTIA``.
        used: Mask of the samples that the fit may use, shape (T,).
        drive_per_rad: Reported drive, as a share of the full drive, per radian of error; None if
            the servo does not report its drive.
    """

    name: str
    file: str
    t: Array
    command: Array
    position: Array
    load: Load
    used: Mask
    drive_per_rad: float | None = None

    def window(self, length_s: float) -> Trace:
        """The trace from the first change of the command on, for at most ``length_s`` seconds."""
        moves = np.flatnonzero(np.diff(self.command))
        first = int(moves[0]) if moves.size else 0
        last = int(np.searchsorted(self.t, self.t[first] + length_s))
        part = slice(first, max(last, first + 2))
        return replace(
            self,
            t=self.t[part],
            command=self.command[part],
            position=self.position[part],
            used=self.used[part],
        )

    @property
    def measured(self) -> Array:
        """Measured angles in rad, NaN where not used, shape (T,)."""
        return np.where(self.used, self.position, np.nan)

    @property
    def period_s(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration_s(self) -> float:
        """Time between the first and the last sample, s."""
        return float(self.t[-1] - self.t[0])

    def quantization_step(self) -> float:
        """Step on which the used angles lie, in rad; 0 if there is none."""
        return quantization_step(self.measured)

    def activity(self) -> float:
        """Total variation of the command in rad."""
        return float(np.abs(np.diff(self.command)).sum())

    def moves(self) -> bool:
        """Whether both the command and the measured angle change."""
        measured = self.position[np.isfinite(self.position)]
        return self.activity() > 0 and measured.size > 1 and float(np.ptp(measured)) > 0


def trace(recording: Recording, joint: str) -> Trace:
    """The trace of ``joint`` in ``recording``, without samples with the torque off."""
    j = recording.joints.index(joint)
    powered = slice(0, recording.powered(j))
    position = recording.position[powered, j]
    error = recording.command[powered, j] - position
    reported = recording.columns.get(f"{joint}.load")
    return Trace(
        name=recording.name,
        file=recording.file,
        t=recording.t[powered],
        command=recording.command[powered, j],
        position=position,
        load=recording.loads.get(joint, PER_INERTIA),
        used=np.isfinite(position),
        drive_per_rad=None if reported is None else drive_slope(error, reported[powered]),
    )


def drive_slope(error: Array, load: Array) -> float | None:
    """Slope of the load that a servo reports against its control error, if the load is its drive.

    The reported load is assumed to be the drive, as a share of the full drive, if it is between -1
    and 1 and proportional to the error until it saturates; a measured torque or current is not.
    """
    valid = np.isfinite(error) & np.isfinite(load)
    if np.count_nonzero(valid) < _FEWEST or np.abs(load[valid]).max() > _FULL + _ROUNDING:
        return None
    e, d = error[valid], load[valid]
    unsaturated = (np.abs(d) < _NEARLY_FULL) & (np.abs(e) > 0)
    if np.count_nonzero(unsaturated) < _FEWEST:
        return None
    slope = float(e[unsaturated] @ d[unsaturated] / (e[unsaturated] @ e[unsaturated]))
    residual = d - np.clip(slope * e, -_FULL, _FULL)
    power = float(np.sum(d**2))
    if slope <= 0 or power == 0 or np.sum(residual**2) > _PROPORTIONAL * power:
        return None
    return slope


def sensor_noise(traces: Sequence[Trace]) -> float:
    """Standard deviation of a joint's sensor noise in rad, the largest over its recordings."""
    floors = (noise_floor(trace.t, trace.command, trace.position) for trace in traces)
    return max(FINEST_NOISE_RAD, *floors)


def check_samples(traces: Sequence[Trace], joint: str) -> None:
    """Check that a joint has enough samples for a fit.

    Raises:
        InputError: If it has too few.
    """
    count = sum(int(trace.used.sum()) for trace in traces)
    if count < FEWEST_SAMPLES:
        found = f"{count} measured angles while its torque is on"
        expected = f"at least {FEWEST_SAMPLES}"
        raise InputError(traces[0].file, f"{joint}.position_rad", found, expected)


def check_runs(traces: Sequence[Trace], joint: str) -> None:
    """Check that a joint has enough consecutive samples to fit an autoregressive noise model.

    Raises:
        InputError: If it has too few.
    """
    count = order = 0
    for trace in traces:
        order = max(order, lags(trace.period_s))
        count += int(counting(trace.used, order).sum())
    if count <= order:
        found = f"{count} measured angles that follow {order} others without a gap"
        expected = f"more than {order}: a longer recording, or one with fewer missing samples"
        raise InputError(traces[0].file, f"{joint}.position_rad", found, expected)


def shows_inertia(fitted: Sequence[Trace]) -> bool:
    """Whether the torque scale is known, so that inertia and gains are identifiable separately."""
    return any(t.load.gravity_Nm > 0 for t in fitted) or len({t.load for t in fitted}) > 1


def traces(recordings: Sequence[Recording], joint: str) -> list[Trace]:
    """The traces of ``joint`` in all recordings in which its command and its angle change."""
    candidates = [trace(recording, joint) for recording in recordings if joint in recording.joints]
    return [candidate for candidate in candidates if candidate.t.size > 1 and candidate.moves()]


def split(traces: Sequence[Trace], held_out: str | None) -> tuple[list[Trace], list[Trace], str]:
    """Traces to fit, traces to score, and a description of what is held out.

    In the traces to score, ``used`` marks only samples that the fit does not use.
    """
    if len(traces) > 1:
        last = next((trace for trace in traces if trace.name == held_out), traces[-1])
        return [trace for trace in traces if trace is not last], [last], last.name
    whole = traces[0]
    until = whole.t[0] + (1 - HELD_OUT_SHARE) * (whole.t[-1] - whole.t[0])
    early = whole.t < until
    if not replace(whole, position=np.where(early, whole.position, np.nan)).moves():
        return [whole], [], "nothing"
    fitted_part = replace(whole, used=whole.used & early)
    return (
        [fitted_part],
        [replace(whole, used=whole.used & ~early)],
        f"{whole.name} after {until - whole.t[0]:.1f} s",
    )
