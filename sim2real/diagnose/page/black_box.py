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

UNITS = (120, 60)
"""Random features of a torque on the shaft, and of an error of the angle itself."""
_MEMORY_S = (0.05, 0.15, 0.5)
_ROUGHNESS, _OFFSET = 1.5, 1.5
_SMALL_SPEED = 0.05
_STOPS = (0.003, 0.01, 0.03, 0.1)
_RIDGES = np.logspace(-7, 1, 9)
_CHUNKS = 5
_ROUNDS = 2
_NETWORKS = 6
"""For all folds together: the mean of several errs less than each, and many folds take long."""


@dataclass(frozen=True)
class _Network:
    """A random hidden layer: its inputs' place, size and range, its weights and offsets."""

    place: Array
    size: Array
    low: Array
    high: Array
    weight: Array
    offset: Array


def black_box(folds: Sequence[Split], rng: np.random.Generator) -> float:
    """Held-out error of the plain servo with a black box beside it, rad.

    Random features (Rahimi, Recht, Weighted sums of random kitchen sinks, NIPS 21 (2008) 1313-1320)
    of the simulated motion and the history of the command, as torques through the linearised servo
    and as errors of the angle; ridge regression on the fitted side, its strength by
    cross-validation there, with nothing at all as one of the choices.

    Args:
        folds: Refits of the plain servo.
        rng: For the features.
    """
    errors: list[Array] = []
    each = int(np.clip(_NETWORKS // len(folds), 1, 3))
    for fold in folds:
        several = [_left(fold, rng) for _ in range(each)]
        errors += [np.mean(lefts, axis=0) for lefts in zip(*several, strict=True)]
    return rms(errors)


def _left(fold: Split, rng: np.random.Generator) -> list[Array]:
    fitted = {k: one.angle for k, one in enumerate(fold.fitted)}
    scored = {k: one.angle for k, one in enumerate(fold.scored)}
    target = np.concatenate([-one.residual for one in fold.fitted])
    network = None
    best = float(np.sum(target**2))
    after = [one.residual for one in fold.scored]
    for _ in range(_ROUNDS):
        seen = [_inputs(one, fitted[k], fold.theta) for k, one in enumerate(fold.fitted)]
        network = network or _network(np.concatenate(seen), rng)
        whole = [
            _columns(network, x, o, fold.theta) for x, o in zip(seen, fold.fitted, strict=True)
        ]
        rows = np.concatenate([x[o.trace.used] for x, o in zip(whole, fold.fitted, strict=True)])
        weight, error2 = _ridge(rows, target)
        if error2 >= best:
            break
        best = error2
        # With what it adds, the motion is nearer to the real one: look at that.
        fitted = {k: o.angle + whole[k] @ weight for k, o in enumerate(fold.fitted)}
        other = [
            _columns(network, _inputs(o, scored[k], fold.theta), o, fold.theta)
            for k, o in enumerate(fold.scored)
        ]
        scored = {k: o.angle + other[k] @ weight for k, o in enumerate(fold.scored)}
        after = [
            scored[k][o.trace.used] - o.trace.position[o.trace.used]
            for k, o in enumerate(fold.scored)
        ]
    return after


def _inputs(one: Side, angle: Array, theta: Array) -> Array:
    """What the network sees at each moment, shape (T, I)."""
    t, step = one.trace.t, float(np.median(np.diff(one.trace.t)))
    sent = np.interp(t - theta[2], t, one.trace.command)
    speed = np.gradient(angle, t)
    error = sent - angle
    past = [_recent(x, step, memory) for x in (sent, speed) for memory in _MEMORY_S]
    sign = np.tanh(speed / _SMALL_SPEED)
    inputs = [angle, speed, np.gradient(speed, t), error, sent, sign, t - t[0], *past]
    return np.column_stack([*inputs, _stops(angle)])


def _stops(angle: Array) -> Array:
    """How far the angle has gone since it turned, up to some distances, shape (T, len(_STOPS)).

    What has hysteresis can be made of these: Brokate, Sprekels, Hysteresis and Phase Transitions
    (Springer 1996), section 2.3 (the stop operator).
    """
    reach = np.array(_STOPS)
    gone = np.zeros((angle.size, reach.size))
    for k, move in enumerate(np.diff(angle), start=1):
        gone[k] = np.minimum(np.maximum(gone[k - 1] + move, -reach), reach)
    return gone


def _recent(x: Array, step: float, memory_s: float) -> Array:
    """Exponentially weighted mean of the past, from rest on the first value."""
    keep = float(np.exp(-step / memory_s))
    return np.asarray(x[0] + lfilter([1 - keep], [1.0, -keep], x - x[0]))


def _network(inputs: Array, rng: np.random.Generator) -> _Network:
    width = inputs.shape[1]
    # Each unit looks at a few inputs only: of all at once, one would see nothing but their noise.
    few = rng.random((width, sum(UNITS))) < 3 / width
    weight = _ROUGHNESS * rng.standard_normal(few.shape) * few
    offset = rng.uniform(-_OFFSET, _OFFSET, sum(UNITS))
    size = inputs.std(axis=0) + 1e-12
    ends = inputs.min(axis=0), inputs.max(axis=0)
    return _Network(inputs.mean(axis=0), size, *ends, weight, offset)


def _columns(network: _Network, inputs: Array, one: Side, theta: Array) -> Array:
    """What each feature does to the angle, rad for a torque of 1 N m or an angle of 1, (T, D)."""
    # What it has not seen it takes for the nearest that it has seen.
    x = (np.clip(inputs, network.low, network.high) - network.place) / network.size
    hidden = np.tanh(x @ network.weight + network.offset)
    load, step = one.trace.load, float(np.median(np.diff(one.trace.t)))
    kp, kd = float(theta[0]), float(theta[1])
    servo = torque_filter(load.inertia_kgm2, kd, kp + load.gravity_Nm, step)
    torque = np.hstack([hidden[:, : UNITS[0]], x])
    # The recording starts at rest: what a constant torque does has been done.
    moved = through(torque - torque[:1], servo) + torque[:1] / (kp + load.gravity_Nm)
    return np.hstack([kp * moved, hidden[:, UNITS[0] :], x, np.ones((x.shape[0], 1))])


def _ridge(rows: Array, target: Array) -> tuple[Array, float]:
    """Weights of least error in cross-validation over segments, and that error squared."""
    size = np.sqrt((rows**2).mean(axis=0)) + 1e-12
    design = rows / size
    chunks = np.array_split(np.arange(target.size), _CHUNKS)
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
