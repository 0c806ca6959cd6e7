"""A floor: how much of the error a black box could explain that knows no physics.

It sees what a simulation sees, the commands and what the plain servo does with them, and never a
measurement of the recording that it is scored on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sim2real.identification.held_out import Side, Split
from sim2real.inference.folds import rms
from sim2real.servo.linearised import through, torque_filter

Array = NDArray[np.float64]

_RIDGES = np.logspace(-7, 1, 9)


@dataclass(frozen=True)
class BlackBoxSettings:
    """Size of the black box, and what it sees.

    Attributes:
        units: Random features of a torque on the shaft, and of an error of the angle itself.
        memories_s: Times over which the past of command and speed is averaged.
        weight_sd: Standard deviation of the weights of a feature.
        largest_offset: Largest offset of a feature.
        small_speed_rad_s: Speed below which its sign is not certain.
        stops_rad: Distances of the stop operators.
        chunks: Parts of the data in the cross-validation of the ridge.
        rounds: Fits, each along the motion that the one before predicts.
        networks: Networks for all folds together: the mean of several errs less than each, and many
            folds take long.
    """

    units: tuple[int, int] = (120, 60)
    memories_s: tuple[float, float, float] = (0.05, 0.15, 0.5)
    weight_sd: float = 1.5
    largest_offset: float = 1.5
    small_speed_rad_s: float = 0.05
    stops_rad: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1)
    chunks: int = 5
    rounds: int = 2
    networks: int = 6


BLACK_BOX = BlackBoxSettings()
"""The defaults."""


@dataclass(frozen=True)
class _Network:
    """A random hidden layer: its inputs' place, size and range, its weights and offsets."""

    place: Array
    size: Array
    low: Array
    high: Array
    weight: Array
    offset: Array


def black_box(
    folds: Sequence[Split], rng: np.random.Generator, *, settings: BlackBoxSettings = BLACK_BOX
) -> float:
    """Held-out error of the plain servo with a black box beside it, rad.

    Random features (Rahimi, Recht, Weighted sums of random kitchen sinks, NIPS 21 (2008) 1313-1320)
    of the simulated motion and the history of the command, as torques through the linearised servo
    and as errors of the angle; ridge regression on the fitted side, its strength by
    cross-validation there, with nothing at all as one of the choices.

    Args:
        folds: Refits of the plain servo.
        rng: For the features.
        settings: Settings of the black box.
    """
    errors: list[Array] = []
    each = int(np.clip(settings.networks // len(folds), 1, 3))
    for fold in folds:
        several = [_left(fold, rng, settings=settings) for _ in range(each)]
        errors += [np.mean(lefts, axis=0) for lefts in zip(*several, strict=True)]
    return rms(errors)


def _left(fold: Split, rng: np.random.Generator, *, settings: BlackBoxSettings) -> list[Array]:
    fitted = {k: one.angle for k, one in enumerate(fold.fitted)}
    scored = {k: one.angle for k, one in enumerate(fold.scored)}
    target = np.concatenate([-one.residual for one in fold.fitted])
    network = None
    best = float(np.sum(target**2))
    after = [one.residual for one in fold.scored]
    for _ in range(settings.rounds):
        seen = [
            _inputs(one, fitted[k], fold.theta, settings=settings)
            for k, one in enumerate(fold.fitted)
        ]
        network = network or _network(np.concatenate(seen), rng, settings=settings)
        whole = [
            _columns(network, x, o, fold.theta, settings=settings)
            for x, o in zip(seen, fold.fitted, strict=True)
        ]
        rows = np.concatenate([x[o.trace.used] for x, o in zip(whole, fold.fitted, strict=True)])
        weight, error2 = _ridge(rows, target, settings=settings)
        if error2 >= best:
            break
        best = error2
        # With what it adds, the motion is nearer to the real one: look at that.
        fitted = {k: o.angle + whole[k] @ weight for k, o in enumerate(fold.fitted)}
        other = [
            _columns(
                network,
                _inputs(o, scored[k], fold.theta, settings=settings),
                o,
                fold.theta,
                settings=settings,
            )
            for k, o in enumerate(fold.scored)
        ]
        scored = {k: o.angle + other[k] @ weight for k, o in enumerate(fold.scored)}
        after = [
            scored[k][o.trace.used] - o.trace.position[o.trace.used]
            for k, o in enumerate(fold.scored)
        ]
    return after


def _inputs(one: Side, angle: Array, theta: Array, *, settings: BlackBoxSettings) -> Array:
    """What the network sees at each moment, shape (T, I)."""
    t, step = one.trace.t, float(np.median(np.diff(one.trace.t)))
    sent = np.interp(t - theta[2], t, one.trace.command)
    speed = np.gradient(angle, t)
    error = sent - angle
    past = [_recent(x, step, memory) for x in (sent, speed) for memory in settings.memories_s]
    sign = np.tanh(speed / settings.small_speed_rad_s)
    inputs = [angle, speed, np.gradient(speed, t), error, sent, sign, t - t[0], *past]
    return np.column_stack([*inputs, _stops(angle, settings=settings)])


def _stops(angle: Array, *, settings: BlackBoxSettings) -> Array:
    """How far the angle has gone since it turned, up to some distances, shape (T, number of stops).

    What has hysteresis can be made of these: Brokate, Sprekels, Hysteresis and Phase Transitions
    (Springer 1996), section 2.3 (the stop operator).
    """
    reach = np.array(settings.stops_rad)
    gone = np.zeros((angle.size, reach.size))
    for k, move in enumerate(np.diff(angle), start=1):
        gone[k] = np.minimum(np.maximum(gone[k - 1] + move, -reach), reach)
    return gone


def _recent(x: Array, step: float, memory_s: float) -> Array:
    """Exponentially weighted mean of the past, from rest on the first value."""
    keep = float(np.exp(-step / memory_s))
    return np.asarray(x[0] + lfilter([1 - keep], [1.0, -keep], x - x[0]))


def _network(inputs: Array, rng: np.random.Generator, *, settings: BlackBoxSettings) -> _Network:
    width = inputs.shape[1]
    # Each unit looks at a few inputs only: of all at once, one would see nothing but their noise.
    few = rng.random((width, sum(settings.units))) < 3 / width
    weight = settings.weight_sd * rng.standard_normal(few.shape) * few
    offset = rng.uniform(-settings.largest_offset, settings.largest_offset, sum(settings.units))
    size = inputs.std(axis=0) + 1e-12
    ends = inputs.min(axis=0), inputs.max(axis=0)
    return _Network(inputs.mean(axis=0), size, *ends, weight, offset)


def _columns(
    network: _Network, inputs: Array, one: Side, theta: Array, *, settings: BlackBoxSettings
) -> Array:
    """What each feature does to the angle, rad for a torque of 1 N m or an angle of 1, (T, D)."""
    # What it has not seen it takes for the nearest that it has seen.
    x = (np.clip(inputs, network.low, network.high) - network.place) / network.size
    hidden = np.tanh(x @ network.weight + network.offset)
    load, step = one.trace.load, float(np.median(np.diff(one.trace.t)))
    kp, kd = float(theta[0]), float(theta[1])
    servo = torque_filter(load.inertia_kgm2, kd, kp + load.gravity_Nm, step)
    torque = np.hstack([hidden[:, : settings.units[0]], x])
    # The recording starts at rest: what a constant torque does has been done.
    moved = through(torque - torque[:1], servo) + torque[:1] / (kp + load.gravity_Nm)
    return np.hstack([kp * moved, hidden[:, settings.units[0] :], x, np.ones((x.shape[0], 1))])


def _ridge(rows: Array, target: Array, *, settings: BlackBoxSettings) -> tuple[Array, float]:
    """Weights of least error in cross-validation over segments, and that error squared."""
    size = np.sqrt((rows**2).mean(axis=0)) + 1e-12
    design = rows / size
    chunks = np.array_split(np.arange(target.size), settings.chunks)
    grams = np.array([design[c].T @ design[c] for c in chunks])
    sides = np.array([design[c].T @ target[c] for c in chunks])
    error2 = np.zeros(_RIDGES.size)
    for k, chunk in enumerate(chunks):
        weights = _path(grams.sum(axis=0) - grams[k], sides.sum(axis=0) - sides[k])
        error2 += ((target[chunk, None] - design[chunk] @ weights) ** 2).sum(axis=0)
    best = int(error2.argmin())
    weights = _path(grams.sum(axis=0), sides.sum(axis=0))
    return weights[:, best] / size, float(error2[best])


def _path(gram: Array, side: Array) -> Array:
    """Ridge weights for every strength of ``_RIDGES``, shape (D, ridges)."""
    value, vector = np.linalg.eigh(gram)
    ridge = _RIDGES * float(value.max())
    turned = vector.T @ side
    return np.asarray(vector @ (turned[:, None] / (np.maximum(value, 0)[:, None] + ridge)))
