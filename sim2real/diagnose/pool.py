"""A joint's references and its case under one servo: what each effect would do in each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.candidates import REFITTED, RIPPLE, candidate
from sim2real.diagnose.replicates import freed_of_the_common
from sim2real.diagnose.search import Set
from sim2real.effects import named
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.problem import Fits, Servos, minimise, variants
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

EITHER_SIGN = ("gravity_load", "unmodelled_inertia")
"""Effects of which a recording may have less than its references."""


@dataclass(frozen=True)
class Pool:
    """Inner products of innovations, recording by recording.

    Attributes:
        gram: Of the shared servo's residual (0), of its derivatives by its F free parameters
            (1 to F) and of what each of S starts of an effect adds, shape (R, 1 + F + S,
            1 + F + S), rad2.
        count: Samples that count, shape (R,).
        references: How many of the recordings are references; they come first.
        shared: How many parameters the recordings share (F).
        directions: For each column but the first the effect, or the plain servo's parameter.
        signed: Which of them mean something with either sign, shape (F + S,).
        replicated: Whether what is common to replicates has been taken away.
        fitted: What it was worked out from; None of one made by hand.
    """

    gram: Array
    count: Array
    references: int
    shared: int
    directions: tuple[str, ...]
    signed: NDArray[np.bool_]
    replicated: bool
    fitted: Fitted | None = None


@dataclass(frozen=True)
class Fitted:
    """The servo that a pool shares.

    Attributes:
        traces: The recordings, less what is common to replicates.
        servos: The servo, of one row.
        noise: Its noise model on the references, shape (1, lags).
        rows: Parameters of each direction, shape (F + S, P).
    """

    traces: tuple[Trace, ...]
    servos: Servos
    noise: Array
    rows: Array


def pooled(
    references: Sequence[Trace],
    case: Sequence[Trace],
    servos: Sequence[Servos],
    device: str = "cpu",
) -> Pool:
    """Fit one servo to all recordings of a joint and look at every effect from there.

    The noise is what this servo leaves of the references: what it cannot explain there is no sign
    of a change.

    Args:
        references: The joint's references.
        case: The joint's recordings in question.
        servos: Where to start from, each of one row, with the same free parameters.
        device: Warp device.
    """
    every = [*references, *case]
    batch = Batch([every], device)
    fits = [minimise(batch, one, iterations=15) for one in servos]
    best = max(fits, key=lambda fit: float(fit.loglikelihood[0]))
    alone = Problems(best.servos.joint, best.servos.theta[:, None], np.zeros((1, 1)))
    left = batch.evaluate(alone, keep=True).residual
    assert left is not None
    freed, replicated = freed_of_the_common(every, list(left[0]), len(references))
    same = bool(replicated[len(references) :].all())
    if same:
        every = freed
        batch = Batch([every], device)
    noise = Batch([every[: len(references)]], device).evaluate(alone).autoregression
    directions, signed, problems = _looks(best, batch)
    noise = _of_length(noise, batch.lags)
    seen = batch.evaluate(problems, autoregression=noise)
    shared = best.servos.columns.shape[1]
    return Pool(
        _finite(seen.gram[0]),
        batch.samples.astype(np.float64),
        len(references),
        shared,
        directions,
        signed,
        same,
        Fitted(tuple(every), best.servos, noise, problems.theta[0, 1:]),
    )


def _finite(gram: Array) -> Array:
    """Inner products without the starts from which a servo is unstable."""
    clean = gram.copy()
    bad = np.flatnonzero(~np.isfinite(np.einsum("rkk->rk", gram)).all(axis=0))
    clean[:, bad] = clean[:, :, bad] = 0.0
    return clean


def _of_length(noise: Array, lags: int) -> Array:
    """Coefficients of a noise model with those of further lags left out or 0, shape (1, lags)."""
    return np.pad(noise, ((0, 0), (0, max(0, lags - noise.shape[1]))))[:, :lags]


def _looks(fit: Fits, batch: Batch) -> tuple[tuple[str, ...], NDArray[np.bool_], Problems]:
    """The servo, a little more of each free parameter, and every start of every other effect."""
    own = variants(fit.servos)
    shared = fit.servos.columns.shape[1]
    kp, inertia = float(fit.servos.theta[0, 0]), float(batch.load[0, 0])
    names = [COLUMNS[c].partition(".")[0] for c in fit.servos.columns[0]]
    families = {named(n).family for n in set(names) - set(BASE)} - {""}
    options = [
        candidate(effect, kp, inertia)
        for effect in REFITTED
        if effect.name not in (*names, RIPPLE) and effect.family not in families
    ]
    rows, effects = [], []
    for option in options:
        for start in option.starts:
            row = fit.servos.theta[0].copy()
            row[option.columns] = start
            rows.append(row)
            effects.append(option.effect.name)
    theta = np.concatenate([own.theta[0], np.array(rows)])
    scale = np.concatenate([own.scale[0], np.ones(len(rows))])
    directions = (*names, *effects)
    signed = np.array([k < shared or d in EITHER_SIGN for k, d in enumerate(directions)])
    return directions, signed, Problems(fit.servos.joint, theta[None], scale[None])


def shared_servo(plain: Servos, effects: Set, theta: Array, inertia: float) -> Servos:
    """The servo of a fit with other parameters, free in those of the plain servo and of effects.

    Args:
        plain: The fit's servo, of one row.
        effects: Effects whose parameters are free.
        theta: Where to start, shape (P,).
        inertia: Of the load, kg m2.
    """
    kp = float(plain.theta[0, 0])
    given = [candidate(named(e), kp, inertia) for e in sorted(effects) if e in _NAMES]
    return replace(
        plain,
        joint=np.zeros(1, dtype=np.int32),
        theta=theta[None].copy(),
        columns=np.concatenate([np.arange(3, dtype=np.int32), *(c.columns for c in given)])[None],
        unit=np.concatenate([plain.unit[0, :3], *(c.unit for c in given)])[None],
        low=np.concatenate([plain.low[0, :3], *(c.low for c in given)])[None],
        high=np.concatenate([plain.high[0, :3], *(c.high for c in given)])[None],
    )


_NAMES = frozenset(effect.name for effect in REFITTED)
