"""Autoregressive noise of an angle, with normal innovations of two sizes: in motion and at rest.

Innovations are smaller at rest where the sensor is coarser than its noise; with one size, larger
innovations in motion would pass for irregular timing of set-points, which is tested against it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.inference.correlated_noise import autoregression, counting, lag_products, whitened
from sim2real.servo.event_filter import Channel
from sim2real.servo.linearised import Residual, gain_derivatives, servo_modes

_RATIOS = (0.1, 10.0)
"""Smallest and largest noise at rest, relative to that in motion."""


@dataclass(frozen=True)
class Noise:
    """Autoregressive noise with innovations of two sizes."""

    model: Array  # coefficients, shape (p,)
    ratio: float  # standard deviation of the innovations at rest, relative to those in motion
    variance: float  # of the innovations in motion, in rad2
    # how far the latency in s and the logarithms of kd and kp are too large, shape (3,)
    refit: Array


@dataclass(frozen=True)
class Segment:
    """One recording of one joint."""

    source: Residual  # the recording
    derivatives: Array  # of the angle, as ``gain_derivatives`` returns them
    residual: Array  # simulated minus measured angle in rad, 0 where not used, shape (T,)
    counts: Mask  # samples whose innovations count, shape (T,)
    rests: Mask  # samples at which the joint is at rest, shape (T,)

    def weight(self, ratio: float) -> Array:
        """One over the size of the noise relative to that in motion, 0 where not counted, (T,)."""
        weight = np.where(self.counts, np.where(self.rests, 1 / ratio, 1.0), 0.0)
        return self.source.trace.standardised(weight)

    def innovations(self, noise: Noise) -> Array:
        """Innovations of the corrected residual, as of a joint at rest, shape (T,)."""
        return self.source.trace.standardised(whitened(self.corrected(noise.refit), noise.model))

    def corrected(self, refit: Array) -> Array:
        """Residual after a change of latency, kd and kp by ``refit`` (3,), shape (T,)."""
        return self.residual - self.derivatives @ refit

    def channel(self, noise: Noise) -> Channel:
        """The recording as an ``EventFilter`` takes it."""
        of, residual = self.source, self.corrected(noise.refit)
        scale = np.where(self.counts, np.where(self.rests, noise.ratio, 1.0), 0.0)
        scale *= of.trace.noise_ratio
        return Channel(
            of.trace.t, of.trace.command, of.arrival_s, servo_modes(of), residual, scale,
            self.rests, noise.model, noise.variance,
        )  # fmt: skip


@dataclass(frozen=True)
class NoisyJoint:
    """All recordings of one joint, and the noise that best explains what a fit leaves of them."""

    segments: tuple[Segment, ...]  # the recordings
    noise: Noise  # the noise
    least_gain: float  # least gain of the whitening filter at frequency 0

    @property
    def count(self) -> int:
        """Samples that count."""
        return sum(int(s.counts.sum()) for s in self.segments)

    def variance(self, error2: float) -> float:
        """Most probable variance of the innovations in motion, in rad2."""
        return max(error2 / self.count, 1e-9**2)

    def refitted(self, noise: Noise) -> tuple[Noise, float]:
        """The noise with its variance and ``refit`` at their best, and its log-likelihood."""
        products = np.zeros((4, 4))
        for s in self.segments:
            columns = np.column_stack([s.residual, s.derivatives])
            columns = whitened(columns, noise.model, axis=0) * s.weight(noise.ratio)[:, None]
            products += columns.T @ columns
        normal = products[1:, 1:]
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size) + 1e-10 * np.eye(3)
        refit = np.linalg.solve(scaled, products[1:, 0] / size) / size
        variance = self.variance(float(products[0, 0] - products[0, 1:] @ refit))
        rest = sum(int((s.counts & s.rests).sum()) for s in self.segments)
        level = -0.5 * self.count * np.log(variance) - rest * np.log(noise.ratio)
        return replace(noise, variance=variance, refit=refit), float(level)

    def settled(self, noise: Noise) -> tuple[Noise, float]:
        """The same, its sizes at their best as well."""
        pairs = [(s, s.innovations(noise)) for s in self.segments]
        rest = np.concatenate([e[s.counts & s.rests] for s, e in pairs])
        moving = np.concatenate([e[s.counts & ~s.rests] for s, e in pairs])
        ratio = 1.0
        if rest.size and moving.any():
            ratio = float(np.clip(np.sqrt(np.mean(rest**2) / np.mean(moving**2)), *_RATIOS))
        return self.refitted(replace(noise, ratio=ratio))

    def remodelled(self, noise: Noise, uncertainty: Array | None = None) -> Noise:
        """The noise with its autoregression refitted to the residuals under its ``refit``.

        An uncertain part of the residuals adds lag products in motion and at rest, in rad2, shape
        (2, p + 1, p + 1).
        """
        p = noise.model.size
        products = np.zeros((p + 1, p + 1))
        if uncertainty is not None:
            products += uncertainty[0] + uncertainty[1] / noise.ratio**2
        for segment in self.segments:
            residual = segment.corrected(noise.refit)
            for mask, size in ((~segment.rests, 1.0), (segment.rests, noise.ratio)):
                products += lag_products(residual, segment.counts & mask, p) / size**2
        return replace(noise, model=autoregression(products[None], self.least_gain)[0])


def with_noise(
    recordings: Sequence[Residual], lags: int, least_gain: float, *, iterations: int = 20
) -> NoisyJoint:
    """Fit the noise of one joint by maximum likelihood, set-points arriving at the latency.

    The autoregression has ``lags`` coefficients, and fewer samples that count are a ValueError;
    its whitening filter has at least this gain at frequency 0.
    """
    segments = tuple(
        Segment(
            source,
            gain_derivatives(source),
            np.where(source.trace.used, source.residual, 0.0),
            counting(source.trace.used, lags),
            np.zeros(source.trace.used.size, dtype=bool),
        )
        for source in recordings
    )
    noise = Noise(np.zeros(lags), 1.0, 1.0, np.zeros(3))
    joint = NoisyJoint(segments, noise, least_gain)
    if joint.count <= lags:
        raise ValueError(f"{joint.count} samples count; {lags} lags take more")
    noise = joint.remodelled(noise)
    joint = replace(joint, segments=_with_rest(segments, noise.model))
    before = -np.inf
    for _ in range(iterations):
        noise, value = joint.settled(noise)
        if value < before + 0.01:
            break
        before, noise = value, joint.remodelled(noise)
    return replace(joint, noise=noise)


def _with_rest(
    segments: Sequence[Segment], model: Array, *, fewest: int = 100
) -> tuple[Segment, ...]:
    """The recordings with the most probable speed below which a sample rests."""
    plain = Noise(model, 1.0, 1.0, np.zeros(3))
    square = np.concatenate([s.innovations(plain)[s.counts] ** 2 for s in segments])
    speeds = [np.abs(s.derivatives[:, 0]) for s in segments]
    speed = np.concatenate([v[s.counts] for v, s in zip(speeds, segments, strict=True)])
    best, limit = square.size * np.log(square.mean() + 1e-300), -1.0
    for trial in np.quantile(speed, np.linspace(0.1, 0.8, 8)):
        rests = speed <= trial
        if min(rests.sum(), (~rests).sum()) < fewest:
            continue
        moving = square[~rests].mean() + 1e-300
        rest = np.clip(square[rests].mean() / moving, _RATIOS[0] ** 2, _RATIOS[1] ** 2) * moving
        excess = rests.sum() * (square[rests].mean() / rest - 1)
        value = rests.sum() * np.log(rest) + (~rests).sum() * np.log(moving) + excess
        if value < best:
            best, limit = value, float(trial)
    return tuple(replace(s, rests=v <= limit) for s, v in zip(segments, speeds, strict=True))
