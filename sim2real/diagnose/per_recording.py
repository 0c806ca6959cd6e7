"""One servo for references and case: what each effect would do in each recording, and alone in one.

A parameter is shared by all recordings, or some have one of their own. To first order every effect
is looked at so, from one launch (``linearised``, ``gains``); the likeliest are fitted for good
(``fit_own``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import named
from sim2real.inference import least_squares
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.problem import Fits, Servos, minimise, stacked, variants
from sim2real.servo.repeats import freed_of_the_common
from sim2real.servo.screen import candidates
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_ROUNDS = 4
_EVALUATIONS = 15


@dataclass(frozen=True)
class Linear:
    """The servo that all recordings share, and inner products of innovations in each of them.

    Attributes:
        gram: Of the shared servo's residual (0), of its derivatives by its F free parameters
            (1 to F) and of what each of S starts of an effect adds, shape (R, 1 + F + S,
            1 + F + S), rad2.
        count: Samples that count, shape (R,).
        references: How many of the recordings are references; they come first.
        shared: How many parameters the recordings share (F).
        directions: For each column but the first the effect, or the plain servo's parameter.
        signed: Which of them mean something with either sign, shape (F + S,).
        repeated: Whether what is common to recordings of one command has been taken away.
        traces: The recordings, less what is common to those of one command.
        servos: The shared servo, of one row.
        noise: Its noise model on the references, shape (1, lags).
        rows: Parameters of each direction, shape (F + S, P).
    """

    gram: Array
    count: Array
    references: int
    shared: int
    directions: tuple[str, ...]
    signed: NDArray[np.bool_]
    repeated: bool
    traces: tuple[Trace, ...]
    servos: Servos
    noise: Array
    rows: Array


def linearised(
    references: Sequence[Trace],
    case: Sequence[Trace],
    servos: Sequence[Servos],
    device: str = "cpu",
) -> Linear:
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
    batch, best = fitted(every, servos, device)
    alone = Problems(best.servos.joint, best.servos.theta[:, None], np.zeros((1, 1)))
    left = batch.evaluate(alone, keep=True).residual
    assert left is not None
    freed, repeated = freed_of_the_common(every, list(left[0]), len(references))
    same = bool(repeated[len(references) :].all())
    if same:
        every = freed
        batch = Batch([every], device)
    noise = Batch([every[: len(references)]], device).evaluate(alone).autoregression
    directions, signed, problems = _looks(best, batch)
    noise = np.pad(noise, ((0, 0), (0, max(0, batch.lags - noise.shape[1]))))[:, : batch.lags]
    gram = batch.evaluate(problems, autoregression=noise).gram[0]
    # A start from which a servo is unstable tells nothing.
    bad = np.flatnonzero(~np.isfinite(np.einsum("rkk->rk", gram)).all(axis=0))
    gram[:, bad] = gram[:, :, bad] = 0.0
    shared = best.servos.columns.shape[1]
    return Linear(
        gram,
        batch.samples.astype(np.float64),
        len(references),
        shared,
        directions,
        signed,
        same,
        tuple(every),
        best.servos,
        noise,
        problems.theta[0, 1:],
    )


def fitted(
    traces: Sequence[Trace], servos: Sequence[Servos], device: str = "cpu"
) -> tuple[Batch, Fits]:
    """Recordings of one joint, and the likeliest fit to all of them from any of these starts."""
    batch = Batch([list(traces)], device)
    fits = [minimise(batch, one, iterations=15) for one in servos]
    return batch, max(fits, key=lambda fit: float(fit.loglikelihood[0]))


def _looks(fit: Fits, batch: Batch) -> tuple[tuple[str, ...], NDArray[np.bool_], Problems]:
    """The servo, a little more of each free parameter, and every start of every other effect."""
    own = variants(fit.servos)
    shared = fit.servos.columns.shape[1]
    kp, inertia = float(fit.servos.theta[0, 0]), float(batch.load[0, 0])
    names = [COLUMNS[c].partition(".")[0] for c in fit.servos.columns[0]]
    known = [name for name in names if name not in BASE]
    options = [c for c in candidates(known, kp, inertia) if not c.effect.everywhere]
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
    signed = np.array(
        [k < shared or d not in BASE and named(d).either_sign for k, d in enumerate(directions)]
    )
    return directions, signed, Problems(fit.servos.joint, theta[None], scale[None])


def gains(linear: Linear, own: Sequence[int]) -> tuple[Array, Array, Array]:
    """Free each direction in some recordings only, the servo's parameters shared by all.

    Each recording has its own variance, at its best; all is linear in the parameters, so that a
    few rounds of weighted least squares end at the largest likelihood.

    Args:
        linear: The recordings.
        own: Those in which it is free.

    Returns:
        Gain in log-likelihood, change in multiples of the start, and sum of squared innovations
        that is left in these recordings, rad2, each of shape (K,).
    """
    F, K = linear.shared, linear.gram.shape[1] - 1
    mine = np.zeros(len(linear.gram))
    mine[list(own)] = 1.0
    error2 = linear.gram[:, 0, 0]
    slope = np.zeros((len(linear.gram), K, F + 1))
    slope[:, :, :F] = linear.gram[:, None, 1 : 1 + F, 0]
    slope[:, :, F] = linear.gram[:, 0, 1:] * mine[:, None]
    normal = np.zeros((len(linear.gram), K, F + 1, F + 1))
    normal[:, :, :F, :F] = linear.gram[:, None, 1 : 1 + F, 1 : 1 + F]
    cross = linear.gram[:, 1 : 1 + F, 1:] * mine[:, None, None]
    normal[:, :, :F, F] = normal[:, :, F, :F] = cross.transpose(0, 2, 1)
    normal[:, :, F, F] = np.diagonal(linear.gram, axis1=1, axis2=2)[:, 1:] * mine[:, None]
    plain, _ = _largest(error2, slope[:, :1, :F], normal[:, :1, :F, :F], linear.count)
    after, x = _largest(error2, slope, normal, linear.count)
    gain = 0.5 * linear.count @ np.log(plain / after)
    backwards = (x[:, F] < 0) & ~linear.signed
    gain = np.where(backwards, 0.0, np.maximum(gain, 0.0))
    return gain, x[:, F], mine @ after


def _largest(error2: Array, slope: Array, normal: Array, count: Array) -> tuple[Array, Array]:
    """Squared innovations (R, K) and parameters (K, F) where the likelihood is largest."""
    floor = 1e-9 * error2[:, None]
    now = np.repeat(error2[:, None], slope.shape[1], axis=1)
    x = np.zeros(slope.shape[1:])
    size = np.sqrt(np.einsum("rkff->kf", normal))
    size[size == 0] = 1.0
    for _ in range(_ROUNDS):
        weight = count[:, None] / now
        matrix = np.einsum("rk,rkfg->kfg", weight, normal) / (size[:, :, None] * size[:, None])
        right = -np.einsum("rk,rkf->kf", weight, slope) / size
        inverse = np.linalg.pinv(matrix, rcond=1e-9, hermitian=True)
        x = np.einsum("kfg,kg->kf", inverse, right) / size
        change = 2 * np.einsum("rkf,kf->rk", slope, x)
        change += np.einsum("kf,rkfg,kg->rk", x, normal, x)
        now = np.maximum(error2[:, None] + change, floor)
    return now, x


def fit_own(batch: Batch, linear: Linear, owns: Sequence[Servos]) -> tuple[Array, Array, Array]:
    """Fit the shared servo together with each set of parameters that the case has to itself.

    Each recording has a variance of its own.

    Args:
        batch: The references as its first joint and the case as its second.
        linear: The recordings, with the shared servo and its noise.
        owns: The case's servo, of one row, free in what the case has to itself; a fit each.

    Returns:
        Log-likelihood up to a constant, sum of squared innovations in the case in rad2, each of
        shape (H,), and parameters of the case, shape (H, P).
    """
    H, F = len(owns), linear.shared
    before = replace(linear.servos[np.zeros(H, dtype=np.intp)], joint=np.zeros(H, dtype=np.int32))
    own = stacked(owns)
    # Of a parameter that the case has to itself the shared value is the references' alone.
    taken = (before.columns[:, :, None] == own.columns[:, None]).any(axis=2)
    case = Servos(
        np.ones(H, dtype=np.int32),
        own.theta,
        np.hstack([np.where(taken, -1, before.columns), own.columns]),
        *(np.hstack([getattr(x, name) for x in (before, own)]) for name in ("unit", "low", "high")),
    )
    start = case.values()
    start[:, :F] = before.values()
    moving = case.free.copy()
    moving[:, :F] = True

    def expand(x: Array, index: least_squares.Index) -> least_squares.Expansion:
        parts = before[index].at(x[:, :F]), case[index].at(x)
        return _expansion(batch, parts, np.repeat(linear.noise, len(index), axis=0))

    found = least_squares.minimise(
        expand,
        start,
        case.low / case.unit,
        case.high / case.unit,
        free=moving,
        evaluations=_EVALUATIONS,
    )
    # What the case shares stands in its row, too, but for what it has to itself.
    shared, mine = before.at(found.x[:, :F]).theta, case.at(found.x).theta
    alone = np.zeros(mine.shape, dtype=bool)
    row, place = np.nonzero(own.free)
    alone[row, own.columns[row, place]] = True
    at = found.expansion
    return -at.loss, at.aside["left"], np.where(alone, mine, shared)


def _expansion(batch: Batch, parts: tuple[Servos, Servos], model: Array) -> least_squares.Expansion:
    """Profile likelihood of references and case, and what is left of the case."""
    H, size = parts[1].columns.shape
    loss, slope, normal = np.zeros(H), np.zeros((H, size)), np.zeros((H, size, size))
    left = np.zeros(H)
    ends = np.concatenate([[0], np.cumsum(batch.recordings)])
    for part, servos in enumerate(parts):
        count = batch.samples[ends[part] : ends[part + 1]].astype(np.float64)
        seen = batch.evaluate(variants(servos), autoregression=model)
        gram = seen.gram[:, : count.size]
        energy = gram[:, :, 0, 0]
        free = slice(gram.shape[2] - 1)
        weight = count / energy
        loss += 0.5 * np.log(energy) @ count
        slope[:, free] += np.einsum("hr,hrf->hf", weight, gram[:, :, 1:, 0])
        normal[:, free, free] += np.einsum("hr,hrfg->hfg", weight, gram[:, :, 1:, 1:])
        left = energy.sum(axis=1)
    lost = ~np.isfinite(loss)
    loss[lost], left[lost] = np.inf, np.inf
    slope[lost], normal[lost] = 0.0, np.eye(size)
    return least_squares.Expansion(loss, slope, normal, {"left": left})
