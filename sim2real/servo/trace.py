"""Traces: one joint of one recording, prepared for a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.errors import InputError
from sim2real.inference.correlated_noise import SlowErrors, counting, lags
from sim2real.noise import noise_floor, quantization_step
from sim2real.recording import PER_INERTIA, Load, Recording, VaryingLoad
from sim2real.structured import Fields

FINEST_NOISE_RAD = 1e-6
"""Smallest noise: recordings are written with six decimals."""


@dataclass(frozen=True)
class ReportedDrive:
    """Controller that the reported drive shows: ``drive = gain (u(t - latency) - q - lead v)``."""

    per_rad: float  # gain, as a share of the full drive per radian
    latency_s: float  # latency of the set-point u, s
    lead_s: float  # derivative time of the controller, s; 0 for a proportional controller
    period_s: float  # sampling period: a sample's columns may be read at times this far apart


@dataclass(frozen=True)
class Trace:
    """Commands and measured angles of one joint, while its torque was on."""

    name: str  # name of the recording
    file: str  # file of the recording, unique among recordings
    t: Array  # times in s, shape (T,)
    command: Array  # set-points in rad, shape (T,)
    position: Array  # measured angles in rad, shape (T,), NaN where missing
    load: Load  # the stated load, or ``PER_INERTIA``; of a load that varies, its mean inertia
    used: Mask  # mask of the samples that the fit may use, shape (T,)
    # controller that the reported drive shows; None if the servo does not report it
    drive: ReportedDrive | None = None
    supply_ratio: float = 1.0  # supply voltage, relative to that of the other recordings
    # proportional gain of the firmware, relative to that of the other recordings
    gain_ratio: float = 1.0
    # time from ``t`` to the sampling of the angles, by which set-points take effect earlier
    # relative to the angles
    sample_delay_s: float = 0.0
    # load that varies with time, as on an arm; None if it is constant
    varying: VaryingLoad | None = None
    # standard deviation of the noise of each reading, relative to that of a joint at rest, (T,);
    # None where it is the same for all
    spread: Array | None = None
    slow: SlowErrors | None = None  # slow errors beside the noise; None if there are none

    def window(self, length_s: float = 8.0) -> Trace:
        """The trace from the first change of the command on, for at most ``length_s`` seconds."""
        moves = np.flatnonzero(np.diff(self.command))
        first = int(moves[0]) if moves.size else 0
        last = int(np.searchsorted(self.t, self.t[first] + length_s))
        part = slice(first, max(last, first + 2))
        arrays = {name: getattr(self, name)[part] for name in ("t", "command", "position", "used")}
        spread = None if self.spread is None else self.spread[part]
        return replace(self, **arrays, spread=spread)

    @property
    def gain_factor(self) -> float:
        """Factor on the proportional gain: that of the firmware sets a share of the supply."""
        return self.supply_ratio * self.gain_ratio

    @property
    def measured(self) -> Array:
        """Measured angles in rad, NaN where not used, shape (T,)."""
        return np.where(self.used, self.position, np.nan)

    @property
    def noise_ratio(self) -> Array:
        """``spread``, 1 where the noise is the same for all readings, shape (T,)."""
        return np.ones(self.t.size) if self.spread is None else self.spread

    def standardised(self, values: Array) -> Array:
        """Residuals (T,) or (T, K) with the noise of a joint at rest."""
        return (values.T / self.noise_ratio).T

    @property
    def error_ratio(self) -> Array:
        """Standard deviations of readings with their slow errors, over the noise at rest, (T,)."""
        if self.slow is None:
            return self.noise_ratio
        sizes = self.slow.angle_rad, self.slow.delay_s * self.speed()
        variance = sum(np.square(size / self.slow.noise_rad) for size in sizes)
        return np.asarray(np.sqrt(self.noise_ratio**2 + variance))

    @property
    def fit_ratio(self) -> Array:
        """What fits divide residuals by, (T,): ``error_ratio``, 1 without slow errors."""
        return np.ones(self.t.size) if self.slow is None else self.error_ratio

    @property
    def period_s(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration_s(self) -> float:
        """Time between the first and the last sample, s."""
        return float(self.t[-1] - self.t[0])

    @cached_property
    def noise_floor_rad(self) -> float:
        """Standard deviation of the sensor's noise, see ``noise.noise_floor``."""
        return noise_floor(self.t, self.command, self.position)

    @cached_property
    def start_rad(self) -> float:
        """Angle at which friction holds the joint off its first set-point, rad.

        NaN where it differs by noise only, or the joint turns before its set-points change.
        """
        changes = np.flatnonzero(np.diff(self.command))
        angles = self.measured[: changes[0] + 1 if changes.size else 0]
        angles = angles[np.isfinite(angles)]
        if not angles.size:
            return np.nan
        low, middle, high = np.quantile(angles, (0.1, 0.5, 0.9))
        noise = self.noise_floor_rad
        held = abs(middle - self.command[0]) > 3 * noise and high - low <= 4 * noise
        return float(middle) if held else np.nan

    def speed(self, *, samples: int = 5) -> Array:
        """Mean speed of the measured angle around each sample, rad/s, shape (T,)."""
        angle = np.interp(self.t, self.t[self.used], self.position[self.used])
        padded = np.pad(np.gradient(angle, self.t), samples // 2, mode="edge")
        return np.convolve(padded, np.full(samples, 1 / samples), mode="valid")

    def simulated(self, error: Array) -> Array:
        """Simulated angle in rad from its errors at used samples, between these linear, (T,)."""
        return np.interp(self.t, self.t[self.used], self.position[self.used] + error)

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
    t, command = recording.t[powered], recording.command[powered, j]
    load, context, drive = recording.columns.get(f"{joint}.load"), context_of(recording), None
    if load is not None:
        drive = reported_drive(t, command, position, load[powered], context["sample_delay_s"])
    stated, varying = recording.loads.get(joint, PER_INERTIA), recording.varying_loads.get(joint)
    return Trace(
        name=recording.name,
        file=recording.file,
        t=t,
        command=command,
        position=position,
        load=stated if varying is None else Load(varying.mean_inertia_kgm2),
        varying=varying,
        used=np.isfinite(position),
        drive=drive,
        spread=None,
        slow=None,
        **context,
    )


def reported_drive(
    t: Array, command: Array, position: Array, load: Array, sample_delay_s: float = 0.0
) -> ReportedDrive | None:
    """The controller, if the reported load is the drive.

    The load (T,) counts as the drive, as a share of the full drive, if it is between -1 and 1 (up
    to 0.01) and proportional to the control error until it is saturated, from 0.95 on, but for 2 %
    of its power; a measured torque or current is not. Gain, latency and derivative time then follow
    by least squares from at least 50 samples below the limit, to first order in the latency. The
    prior of both times is 0 with a sampling period as standard deviation, which decides where one
    frequency alone cannot tell them from the gain. Angles and loads are sampled ``sample_delay_s``
    after ``t``; NaN where missing.
    """
    error = command - position
    valid = np.isfinite(error) & np.isfinite(load)
    if np.count_nonzero(valid) < 50 or np.abs(load[valid]).max() > 1.01:
        return None
    t, command, position, error, drive = (x[valid] for x in (t, command, position, error, load))
    unsaturated = (np.abs(drive) < 0.95) & (np.abs(error) > 0)
    if np.count_nonzero(unsaturated) < 50:
        return None
    slope = float(error[unsaturated] @ drive[unsaturated] / np.sum(error[unsaturated] ** 2))
    residual = drive - np.clip(slope * error, -1.0, 1.0)
    power = float(np.sum(drive**2))
    if slope <= 0 or power == 0 or np.sum(residual**2) > 0.02 * power:
        return None
    period = float(np.median(np.diff(t)))
    terms = np.stack([error, np.gradient(command, t), np.gradient(position, t)], axis=1)
    noise = np.sqrt(np.mean(residual[unsaturated] ** 2))
    # u(t + delay - latency) has the coefficient gain (delay - latency) of the command's rate
    prior = np.array([[-sample_delay_s, 1.0, 0.0], [0.0, 0.0, 1.0]]) * noise / (slope * period)
    matrix = np.concatenate([terms[unsaturated], prior])
    target = np.concatenate([drive[unsaturated], np.zeros(len(prior))])
    gain, *rates = np.linalg.lstsq(matrix, target, rcond=None)[0]
    sooner, lead = (float(-rate / gain) for rate in rates)
    latency = max(sooner + sample_delay_s, 0.0)
    return ReportedDrive(float(gain), latency, max(lead, 0.0), period)


def context_of(recording: Recording) -> dict[str, float]:
    """``supply_ratio``, ``gain_ratio``, ``sample_delay_s`` of a recording, or an InputError."""
    context = Fields(recording.file, "", recording.metadata).table("context")
    ratios = {name: context.number(name, 1.0, above=0.0) for name in ("supply_ratio", "gain_ratio")}
    return {**ratios, "sample_delay_s": context.number("sample_delay_s", 0.0, low=0.0)}


def at_one_gain(recordings: Sequence[Recording], gain: float | None = None) -> list[Recording]:
    """Recordings whose context states the firmware's gain relative to a common one.

    kp is in proportion to the gain of the firmware, ``firmware_p_gain`` of a recording; the common
    one is by default that of the first recording that states one. Recordings that state no gain, or
    already have a ``gain_ratio``, are left as they are. InputError if a gain is not a positive
    number.
    """
    gains = [firmware_gain(recording) for recording in recordings]
    common = gain or next((stated for stated in gains if stated is not None), None)
    result = []
    for recording, stated in zip(recordings, gains, strict=True):
        context = Fields(recording.file, "", recording.metadata).table("context").content
        if stated is not None and stated != common and "gain_ratio" not in context:
            context = {**context, "gain_ratio": stated / (common or stated)}
            metadata = {**recording.metadata, "context": context}
            recording = replace(recording, metadata=metadata)
        result.append(recording)
    return result


def firmware_gain(recording: Recording) -> float | None:
    """``firmware_p_gain`` of a recording, None where it states none; InputError if it is none."""
    if recording.metadata.get("firmware_p_gain") is None:
        return None
    return Fields(recording.file, "", recording.metadata).number("firmware_p_gain", above=0.0)


def sensor_noise(traces: Sequence[Trace]) -> float:
    """Standard deviation of a joint's sensor noise in rad, the largest over its recordings."""
    return max(FINEST_NOISE_RAD, *(trace.noise_floor_rad for trace in traces))


def fit_noise(traces: Sequence[Trace]) -> float:
    """Standard deviation of white noise alone in the residuals of fits (``fit_ratio``), rad."""
    slow = traces[0].slow
    if slow is None:
        return sensor_noise(traces)
    share = np.concatenate([(t.noise_ratio / t.fit_ratio)[t.used] for t in traces])
    return slow.noise_rad * float(np.sqrt(np.mean(share**2)))


def check_samples(traces: Sequence[Trace], joint: str, *, fewest: int = 20) -> None:
    """Raise an InputError unless a joint has at least ``fewest`` measured angles for a fit."""
    count = sum(int(trace.used.sum()) for trace in traces)
    if count < fewest:
        found = f"{count} measured angles while its torque is on"
        raise InputError(traces[0].file, f"{joint}.position_rad", found, f"at least {fewest}")


def check_runs(traces: Sequence[Trace], joint: str) -> None:
    """Raise an InputError unless enough samples are consecutive for an autoregressive noise."""
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
    weighed = any(t.varying is not None or t.load.gravity_Nm > 0 for t in fitted)
    return weighed or len({t.load for t in fitted}) > 1


def traces(recordings: Sequence[Recording], joint: str) -> list[Trace]:
    """The traces of ``joint`` in all recordings in which its command and its angle change."""
    candidates = [trace(recording, joint) for recording in recordings if joint in recording.joints]
    return [candidate for candidate in candidates if candidate.t.size > 1 and candidate.moves()]


def split(
    traces: Sequence[Trace], held_out: str | None, *, share: float = 0.25
) -> tuple[list[Trace], list[Trace], str]:
    """Traces to fit, traces to score, and a description of what is held out.

    In the traces to score, ``used`` marks only samples that the fit does not use. Of a single
    recording, a share at its end is held out.
    """
    if len(traces) > 1:
        last = next((trace for trace in traces if trace.name == held_out), traces[-1])
        return [trace for trace in traces if trace is not last], [last], last.name
    whole = traces[0]
    until = whole.t[0] + (1 - share) * (whole.t[-1] - whole.t[0])
    early = whole.t < until
    if not replace(whole, position=np.where(early, whole.position, np.nan)).moves():
        return [whole], [], "nothing"
    fitted, scored = (replace(whole, used=whole.used & part) for part in (early, ~early))
    return [fitted], [scored], f"{whole.name} after {until - whole.t[0]:.1f} s"
