"""Where and when something is missing, and whether it is in the catalogue at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.smooth_function import JointMotion, ServoMotion, Smooth, smooth_function
from sim2real.identification.servo_problem import Fits, minimise, residual_angles
from sim2real.inference.correlated_noise import RESIDUAL_WANDER
from sim2real.inference.segments import Window, inside, robust_sd, windows
from sim2real.progress import shared
from sim2real.servo.batch import Batch
from sim2real.servo.trace import FINEST_NOISE_RAD, Trace

Windows = tuple[tuple[Window, ...], ...]


@dataclass(frozen=True)
class Unmodelled:
    """What could be missing, without a name."""

    # energy of the plain fit's residual that is neither noise nor slow wander, in variances of the
    # noise; about 1 where nothing is missing
    excess: float
    smooth: Smooth  # the best smooth function of one state
    # segments outside which the plain servo fits, for each recording, or None
    windows: Windows | None
    # evidence, against the plain servo's, of something of its own in these segments; -inf without
    # them
    windows_evidence: float


def unmodelled(batch: Batch, joints: Sequence[Sequence[Trace]], plain: Fits) -> list[Unmodelled]:
    """Look for physics without a name in the joints of a robot, beside their plain servos."""
    residuals, excesses = beyond_noise(batch, joints, plain)
    suspects = [j for j in range(len(joints)) if excesses[j] > DECISION.noise_like_excess]
    separate = _intermittent(batch, joints, plain, residuals, suspects)
    servos = []
    for j, (kp, kd, latency) in enumerate(plain.servos.theta[:, :3].tolist()):
        motions = _motions(batch, joints, residuals, j)
        noise = batch.least_gain, batch.lags
        servos.append(ServoMotion(motions, kp, kd, latency, *noise, thorough=j in suspects))
    nowhere: tuple[Windows | None, float] = (None, -np.inf)
    return [
        Unmodelled(excesses[j], smooth, *separate.get(j, nowhere))
        for j, smooth in enumerate(shared(smooth_function, servos))
    ]


def beyond_noise(
    batch: Batch, joints: Sequence[Sequence[Trace]], fits: Fits
) -> tuple[Array, list[float]]:
    """What one fit a joint leaves, shape (J, R, T), and the ``excess`` of each."""
    residuals, noise = residual_angles(batch, fits), np.sqrt(fits.error2 / fits.count)
    return residuals, [
        excess(residuals[j], traces, batch, float(noise[j])) for j, traces in enumerate(joints)
    ]


def excess(
    residual: Sequence[Array], traces: Sequence[Trace], batch: Batch, noise_rad: float
) -> float:
    """Energy of residuals, one a recording, beyond a slow wander, in variances of the noise.

    The residual is whitened for white noise and ``RESIDUAL_WANDER``.
    """
    energy, count = 0.0, 0
    for row, trace in zip(residual, traces, strict=False):
        numerator, denominator, spread = RESIDUAL_WANDER.filter(trace.period_s)
        innovation = lfilter(numerator, denominator, trace.standardised(row[: trace.t.size]))
        used = trace.used.copy()
        used[: batch.lags] = False
        energy += float(np.sum(innovation[used] ** 2)) / (1 + spread)
        count += int(used.sum())
    scale = noise_rad**2 / (1 + spread)
    return energy / count / scale


def _intermittent(
    batch: Batch,
    joints: Sequence[Sequence[Trace]],
    plain: Fits,
    residuals: Array,
    suspects: Sequence[int],
    *,
    rounds: int = 3,
) -> dict[int, tuple[Windows, float]]:
    """Windows outside which the plain servo fits, and their evidence, for those joints with any."""
    segments: dict[int, Windows] = {}
    remaining = {j: residuals[j] for j in suspects}
    gains: dict[int, float] = {}
    for _ in range(rounds):
        segments = {
            j: w
            for j, residual in remaining.items()
            if any(w := _windows(residual, joints[j], segments.get(j)))
            and sum(b - a for of_trace in w for a, b in of_trace)
            < DECISION.segments_share * sum(t.duration_s for t in joints[j])
        }
        if not segments:
            return {}
        order = list(segments)
        outside = Batch(
            [[_without(t, w) for t, w in zip(joints[j], segments[j], strict=True)] for j in order],
            batch.device,
            batch.threads,
        )
        start = plain[np.array(order)].servos.of_joints(range(len(order)))
        white = minimise(outside, start, iterations=8, white=True)
        fits = minimise(outside, white.servos, iterations=8)
        square = fits.error2 / np.maximum(fits.count, 1)
        level = -0.5 * np.log(np.maximum(square, FINEST_NOISE_RAD**2))
        after = residual_angles(batch, fits.of_joints(order))
        for k, (j, residual) in enumerate(zip(order, after, strict=True)):
            remaining[j] = residual
            gains[j] = float(level[k] * plain.count[j] - plain.loglikelihood[j])
            if fits.count[k] <= outside.lags:  # too few samples outside explain nothing
                del segments[j]
        remaining = {j: remaining[j] for j in segments}
    # Each segment must earn as much as is never left to chance, and so must each second of it.
    costs = {
        j: DECISION.decisive_gain * sum(1 + b - a for of_trace in w for a, b in of_trace)
        for j, w in segments.items()
    }
    return {j: (w, gains[j] - costs[j]) for j, w in segments.items()}


def _windows(residual: Array, traces: Sequence[Trace], before: Windows | None) -> Windows:
    """Segments of a residual (R, T) beyond the spread outside those of before."""
    rows = measured_only(residual, traces)
    masks = [
        inside(t.t, before[k]) if before else np.zeros(t.t.size, dtype=bool)
        for k, t in enumerate(traces)
    ]
    sd = robust_sd(np.concatenate(rows), np.concatenate(masks))
    return tuple(windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True))


def measured_only(residual: Array, traces: Sequence[Trace]) -> list[Array]:
    """Standardised residuals (R, T) of the recordings, NaN where not used, (T,) each."""
    pairs = zip(residual, traces, strict=False)
    return [np.where(t.used, t.standardised(r[: t.t.size]), np.nan) for r, t in pairs]


def _without(trace: Trace, segments: tuple[Window, ...]) -> Trace:
    wider = tuple((a - 0.1, b + 0.3) for a, b in segments)
    return replace(trace, used=trace.used & ~inside(trace.t, wider))


def _motions(
    batch: Batch, joints: Sequence[Sequence[Trace]], residuals: Array, joint: int
) -> list[JointMotion]:
    """The recordings of a joint, with the simulated angles of its siblings."""
    motions = []
    for r, trace in enumerate(joints[joint]):
        counts = trace.used.copy()
        counts[: batch.lags] = False
        others = [
            simulated_angle(residuals[i, k], other)
            for i, sibling in enumerate(joints)
            for k, other in enumerate(sibling)
            if i != joint and other.file == trace.file and other.t.size == trace.t.size
        ]
        angle = simulated_angle(residuals[joint, r], trace)
        siblings_angles = np.array(others).reshape(len(others), trace.t.size)
        own = residuals[joint, r, : trace.t.size]
        motions.append(JointMotion(trace, angle, own, counts, siblings_angles))
    return motions


def simulated_angle(residual: Array, trace: Trace) -> Array:
    """Simulated angles of a recording; where none was measured, between its neighbours."""
    used = np.flatnonzero(trace.used)
    angle = residual[used] + trace.position[used]
    return np.asarray(np.interp(trace.t, trace.t[used], angle))
