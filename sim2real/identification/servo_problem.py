"""Least-squares problems of many servos at once, including their noise models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.effects import CATALOGUE
from sim2real.inference import least_squares, selection
from sim2real.inference.evidence import profile_loglikelihood
from sim2real.inference.least_squares import OUTLIER_SD, Expansion
from sim2real.servo.batch import Batch, Normal, Problems
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, LINE_COLUMNS
from sim2real.servo.trace import Trace

Set = frozenset[str]

_ASCENDING = [
    [COLUMNS.index(f"{effect.name}.{name}") for name in effect.ascending]
    for effect in CATALOGUE
    if effect.ascending
]
"""Pairs of columns of which the second is never below the first."""
SATURATION = "torque_saturation"
"""The effect that limits a motor's torque at any speed; at the data sheet's torque it is no effect
but the motor's law, and fitted with it."""
FLAT_COLUMNS = np.array([COLUMNS.index(f"{SATURATION}.{x}") for x in ("limit_Nm", "free_damping")])
"""Columns of a limit at any speed, and of the damping beyond it."""
LINE_ROOM = 1.5
"""Largest factor by which a fitted limit may differ from its starting value."""
DIFFERENCE, CONTACT_DIFFERENCE = 2e-4, 0.02
"""Steps of the forward differences, in units; the second where gears have a gap or a dead band
switches.

Single contacts make the error a rough function of the parameters: a step averages over it."""
_ROUGH = [FIRST_COLUMN["backlash"], COLUMNS.index("deadband.step_share")]


@dataclass(frozen=True)
class Servos:
    """Servos with free parameters, each to be fitted to all recordings of one joint."""

    joint: Integers  # index of the joint in the batch, shape (N,)
    theta: Array  # parameters, shape (N, P)
    columns: Integers  # columns of the free ones, -1 where a servo has fewer, shape (N, F)
    unit: Array  # their natural sizes, shape (N, F)
    low: Array  # smallest values, shape (N, F)
    high: Array  # largest values, shape (N, F)

    def __getitem__(self, index: Index | Mask | slice) -> Servos:
        """A selection of the servos."""
        return Servos(*(value[index] for value in vars(self).values()))

    def of_joints(self, joint: Sequence[int]) -> Servos:
        """The same servos on other joints of a batch, shape (N,)."""
        return replace(self, joint=np.array(joint, dtype=np.int32))

    def wide(self, width: int) -> Servos:
        """Add or remove places for free parameters at the end, to ``width`` places."""
        fill = {"columns": -1, "unit": 1.0, "low": 0.0, "high": 0.0}
        parts = {name: _resized(getattr(self, name), width, x) for name, x in fill.items()}
        return replace(self, **parts)

    @property
    def free(self) -> Mask:
        """Mask of the places of ``columns`` that hold a parameter, shape (N, F)."""
        return self.columns >= 0

    def values(self) -> Array:
        """Values of the free parameters in units, 0 where there is none, shape (N, F)."""
        selected = np.take_along_axis(self.theta, np.maximum(self.columns, 0), axis=1)
        return np.where(self.free, selected / self.unit, 0.0)

    def at(self, x: Array) -> Servos:
        """The servos with free parameters ``x`` (N, F), in units, kept within their bounds."""
        theta = self.theta.copy()
        row, place = np.nonzero(self.free)
        value = np.clip(x * self.unit, self.low, self.high)[row, place]
        theta[row, self.columns[row, place]] = value
        for lower, upper in _ASCENDING:
            theta[:, upper] = np.maximum(theta[:, lower], theta[:, upper])
        return replace(self, theta=theta)


def _resized(values: NDArray[Any], width: int, fill: float = 0.0, axis: int = 1) -> NDArray[Any]:
    """Pad with a value, or truncate, to ``width`` places along an axis."""
    widths = [(0, max(0, width - values.shape[axis]) * (k == axis)) for k in range(values.ndim)]
    return np.pad(values, widths, constant_values=fill).take(np.arange(width), axis)


def stacked(servos: Sequence[Servos]) -> Servos:
    """Concatenate servos with different numbers of free parameters, padding to the largest."""
    width = max(part.columns.shape[1] for part in servos)
    parts = [vars(part.wide(width)).values() for part in servos]
    return Servos(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def plain_servos(
    joint: NDArray[np.integer],
    theta: Array,
    inertia: Array,
    period_s: float,
    *,
    free_line: bool = False,
) -> Servos:
    """Servos (N, P) on joints (N,) of a batch, whose gains and latency are free.

    With ``free_line`` the motor's line, if there is one, is free as well. Loads have these inertias
    in kg m2, (N,); natural frequencies are below half the rate of samples that are ``period_s``
    apart.
    """
    kp = np.maximum(theta[:, 0], 1e-9)
    kd = np.maximum(theta[:, 1], 0.4 * np.sqrt(kp * inertia))
    none = np.zeros(kp.size)
    fastest2 = min(1.6e5, (np.pi / period_s) ** 2)
    columns = np.tile(np.arange(3, dtype=np.int32), (kp.size, 1))
    unit = np.stack([kp, kd, none + 0.05], axis=1)
    low = np.stack([1e-3 * inertia, none, none], axis=1)
    high = np.stack([fastest2 * inertia, 1.6e3 * inertia, none + 0.5], axis=1)
    line = theta[:, LINE_COLUMNS]
    has: Mask = np.all(line > 0, axis=1)
    if free_line and has.any():
        columns = np.hstack([columns, np.where(has[:, None], LINE_COLUMNS, -1).astype(np.int32)])
        unit = np.hstack([unit, np.where(has[:, None], line, 1.0)])
        low, high = np.hstack([low, line / LINE_ROOM]), np.hstack([high, line * LINE_ROOM])
    first = np.argsort(columns < 0, axis=1, kind="stable")  # what is free comes first
    free = (np.take_along_axis(x, first, axis=1) for x in (columns, unit, low, high))
    return Servos(joint.astype(np.int32), theta, *free)


@dataclass(frozen=True)
class Fits:
    """Result of a search."""

    servos: Servos  # the servos with fitted parameters
    # inner products of residual (0) and derivatives by the free parameters, by block, in rad2 and
    # units, shape (N, B, 1 + F, 1 + F)
    gram: Array
    count: Array  # number of samples whose innovations count, shape (N,)
    autoregression: Array  # the noise model, shape (N, lags)
    converged: Mask  # whether each search ended at a minimum, shape (N,)

    @property
    def error2(self) -> Array:
        """Sum of squared innovations in rad2, shape (N,)."""
        return np.asarray(self.gram[:, :, 0, 0].sum(axis=1))

    @property
    def loglikelihood(self) -> Array:
        """Log-likelihood with fitted variance and noise model, shape (N,)."""
        return profile_loglikelihood(self.error2, self.count)

    @property
    def variances(self) -> Array:
        """Variances of the free parameters of a single fit, in units, shape (F,).

        Of independent innovations, or of blocks of them where these agree less: the sandwich of
        White, Econometrica 50 (1982) 1-25, with blocks as clusters.
        """
        gram = self.gram[0]
        gram = gram[gram[:, 0, 0] > 0]
        inverse = np.linalg.pinv(gram[:, 1:, 1:].sum(axis=0), rcond=1e-12, hermitian=True)
        independent = np.diag(inverse) * float(self.error2[0] / self.count[0])
        by_block = gram[:, 1:, 0] @ inverse
        freedom = len(gram) / max(len(gram) - len(inverse), 1)
        of_blocks = freedom * (by_block**2).sum(axis=0)
        return np.asarray(np.maximum(independent, of_blocks).clip(min=0.0))

    def __getitem__(self, index: Index | Mask | slice) -> Fits:
        """A selection of the fits."""
        return Fits(*(value[index] for value in vars(self).values()))

    def of_joints(self, joint: Sequence[int]) -> Fits:
        """The same fits on other joints of a batch, shape (N,)."""
        return replace(self, servos=self.servos.of_joints(joint))

    def single(self, n: int) -> Fits:
        """A single fit, without places that hold no parameter."""
        fit = self[np.array([n])]
        return fit.wide(int(fit.servos.free.sum()))

    def resampled(self, weights: Array) -> Array:
        """Log-likelihood of a single fit for each set of weights of its blocks (D, B), shape (D,).

        Its parameters are refitted to first order.
        """
        weights = np.vstack([np.ones(weights.shape[1]), weights])
        x, unit = self.servos.values()[0], self.servos.unit[0]
        low, high = self.servos.low[0] / unit, self.servos.high[0] / unit
        interior = (x > low + 1e-6 * (high - low)) & (x < high - 1e-6 * (high - low))
        kept = np.concatenate([[0], 1 + np.flatnonzero(interior)])
        total = np.einsum("db,bij->dij", weights, self.gram[0][:, kept[:, None], kept])
        normal, slope = total[:, 1:, 1:], total[:, 1:, 0]
        size = np.einsum("dff->df", normal)
        ridge = 1e-9 * size.max(axis=1, initial=0.0) + 1e-300
        normal = normal + ridge[:, None, None] * np.eye(normal.shape[1])
        step = np.linalg.solve(normal, slope[:, :, None])[:, :, 0]
        error2 = total[:, 0, 0] - np.einsum("df,df->d", slope, step)
        score = profile_loglikelihood(error2, np.full(error2.size, float(self.count[0])))
        # If the search did not converge, the gain of a step is overestimated.
        return np.asarray(score[1:] - (score[0] - self.loglikelihood[0]))

    def wide(self, width: int) -> Fits:
        """Change the number of places for free parameters, see ``Servos.wide``."""
        gram = _resized(_resized(self.gram, 1 + width, axis=2), 1 + width, axis=3)
        return replace(self, servos=self.servos.wide(width), gram=gram)


Hypothesis = selection.Hypothesis[Fits]
Tried = selection.Ledger[Fits]
"""All sets of effects that were tried on one joint."""


def joined(fits: Sequence[Fits]) -> Fits:
    """Concatenate fits with different numbers of parameters, padding to the largest."""
    width = max(fit.servos.columns.shape[1] for fit in fits)
    parts = [list(vars(fit.wide(width)).values())[1:] for fit in fits]
    arrays = (np.concatenate(values) for values in zip(*parts, strict=True))
    return Fits(stacked([fit.servos for fit in fits]), *arrays)


def minimise(
    batch: Batch,
    servos: Servos,
    *,
    iterations: int,
    blocks: int = 1,
    white: bool = False,
    hopeless: least_squares.Hopeless | None = None,
) -> Fits:
    """Fit all servos simultaneously (``inference.least_squares``), with one launch per round.

    The noise model of each servo is refitted at every point, which makes the sum of squared
    innovations the profile likelihood; or noise is ``white``. ``iterations`` is the largest number
    of evaluations, ``blocks`` that of blocks of each recording in ``Fits.gram``, and ``hopeless``
    selects servos to stop.
    """
    latest: dict[int, Array] = {}

    def evaluated(x: Array, index: Index, **options: Any) -> Normal:  # noqa: ANN401
        noise = np.zeros((index.size, batch.lags)) if white else None
        return batch.evaluate(variants(servos[index].at(x)), autoregression=noise, **options)

    def losses(x: Array, index: Index) -> Array:
        normal = evaluated(x, index, alone=True)
        assert normal.angles is not None
        latest.update(zip(index.tolist(), normal.angles, strict=True))
        return -profile_loglikelihood(normal.square[:, 0], normal.count)

    def expand(x: Array, index: Index) -> Expansion:
        known = np.array([latest[k] for k in index.tolist()]) if latest else None
        normal = evaluated(x, index, blocks=blocks, known=known)
        gram = np.where(np.isfinite(normal.gram), normal.gram, 0.0)  # a varied servo may diverge
        gram[..., 0, 0] = normal.gram[..., 0, 0]
        total = gram.sum(axis=1)
        share = (normal.count / np.maximum(total[:, 0, 0], 1e-300))[:, None]
        aside = {"gram": gram, "noise": normal.autoregression, "count": normal.count}
        loss = -profile_loglikelihood(total[:, 0, 0], normal.count)
        return Expansion(loss, share * total[:, 1:, 0], share[:, None] * total[:, 1:, 1:], aside)

    with np.errstate(invalid="ignore"):
        low, high = servos.low / servos.unit, servos.high / servos.unit
    minimum = least_squares.minimise(
        expand,
        servos.values(),
        low,
        high,
        free=servos.free,
        evaluations=iterations,
        hopeless=hopeless,
        losses=losses,
    )
    aside = minimum.expansion.aside
    return Fits(
        servos.at(minimum.x), aside["gram"], aside["count"], aside["noise"], minimum.converged
    )


def minimise_robustly(
    joints: Sequence[Sequence[Trace]], servos: Servos, *, iterations: int = 10, rounds: int = 3
) -> Fits:
    """Fit each servo to the recordings of its joint with white noise and the soft L1 loss.

    By reweighted least squares: a sample whose residual is beyond ``OUTLIER_SD`` robust standard
    deviations counts less. Source: Holland, Welsch, Communications in Statistics 6 (1977) 813-827.
    ``iterations`` and ``rounds`` are the largest numbers of evaluations a round, and of rounds.
    """
    weighted = [list(traces) for traces in joints]
    for number in range(rounds):
        batch = Batch(weighted, white=True)
        fits = minimise(batch, servos, iterations=iterations, white=True)
        servos = fits.servos
        if number == rounds - 1:
            break
        errors = residual_angles(batch, fits)
        largest = 0.0
        for n, traces in enumerate(joints):
            pairs = list(zip(traces, errors[n], strict=False))
            ratios = [trace.standardised(error[: trace.t.size]) for trace, error in pairs]
            used = [ratio[trace.used] for ratio, trace in zip(ratios, traces, strict=True)]
            limit = OUTLIER_SD * least_squares.robust_scale(np.concatenate(used))
            largest = max(largest, *(float(np.abs(x).max(initial=0.0)) / limit for x in used))
            weighted[n] = [
                replace(trace, spread=trace.noise_ratio * (1 + (ratio / limit) ** 2) ** 0.25)
                for trace, ratio in zip(traces, ratios, strict=True)
            ]
        if largest < 2:
            break
    return fits


def variants(servos: Servos) -> Problems:
    """Each servo and its forward differences in every free parameter."""
    N, F = servos.columns.shape
    theta = np.repeat(servos.theta[:, None], 1 + F, axis=1)
    row, place = np.nonzero(servos.free)
    column = servos.columns[row, place]
    value = servos.theta[row, column]
    # The step is towards the inside of the bounds.
    rough = np.any(servos.theta[:, _ROUGH] > 0, axis=1)
    step = np.where(rough, CONTACT_DIFFERENCE, DIFFERENCE)[row]
    size = step * servos.unit[row, place]
    size = np.where(value + size > servos.high[row, place], -size, size)
    theta[row, 1 + place, column] = value + size
    scale = np.zeros((N, 1 + F))
    scale[row, 1 + place] = servos.unit[row, place] / size
    return Problems(servos.joint, theta, scale)


def residual_angles(batch: Batch, fits: Fits) -> Array:
    """Simulated minus measured angles of one fit per joint, 0 where missing, shape (N, R, T)."""
    theta = fits.servos.theta[:, None]
    out = batch.evaluate(Problems(fits.servos.joint, theta, np.zeros((len(theta), 1))), keep=True)
    assert out.residual is not None
    return out.residual


def without_flat_limit(row: Array) -> Array:
    """A servo's parameters (P,), a flat limit of its effects as the limit of its motor's law."""
    limit, share = (float(x) for x in row[FLAT_COLUMNS])
    moved = row.copy()
    moved[FLAT_COLUMNS] = 0.0
    damping = max(share, 1e-2) * max(float(row[1]), 1e-9)
    moved[LINE_COLUMNS] = limit, limit / damping
    return moved
