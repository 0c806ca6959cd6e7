"""Effects as candidates: seen linearly, all at once, in what a fit leaves, and free in a fit."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.effects import CATALOGUE, named
from sim2real.effects.effect import SHAPES, SIGNED, STRENGTHS, Effect, scaled
from sim2real.identification.servo_problem import Fits, Servos, Set, variants
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS, CONTROL_SIDE, FIRST_EFFECT_COLUMN

FITTED: tuple[Effect, ...] = tuple(e for e in CATALOGUE if e.fitted and not e.never_named)
"""Effects whose parameters a fit finds, and that may be named."""
NUISANCES: tuple[Effect, ...] = tuple(e for e in CATALOGUE if e.fitted and e.everywhere)
"""What every servo has a little of."""
SIDE_COLUMNS, BRANCH_COLUMNS = (
    [k for k, name in enumerate(COLUMNS) if name.rpartition(".")[2] in some]
    for some in ((CONTROL_SIDE,), (CONTROL_SIDE, "restitution", "step_share"))
)
"""Columns of the controller's side, and of all parameters of gear trains and dead bands whose fits
have a branch at 0 and another one."""
_SENSOR = {"sensor_gain": "gain", "sensor_offset": "offset_rad"}
_WAVES = [
    [COLUMNS.index(f"{effect.name}.{name}_rad") for name in ("period", "phase")]
    for effect in NUISANCES
]
"""Columns of the waves of the angle that every servo has."""


@dataclass(frozen=True)
class Candidate:
    """One effect with K parameters, scaled to a servo."""

    effect: Effect  # the effect
    columns: Integers  # columns of its parameters, shape (K,)
    low: Array  # their smallest values, shape (K,)
    high: Array  # their largest values, shape (K,)
    unit: Array  # their natural sizes, shape (K,)
    starts: Array  # values to start from, shape (S, K)

    def branches(self, some: Index) -> Array:
        """Branches that some of the starts are in, one row each: the side, else whether above 0."""
        own = np.isin(self.columns, BRANCH_COLUMNS)
        values = self.starts[some][:, own]
        return np.where(np.isin(self.columns[own], SIDE_COLUMNS), values, values > 0)


def candidate(effect: Effect, kp: float, inertia: float, *, apart: float = 1.5) -> Candidate:
    """An effect scaled to a servo of ``kp`` N m/rad on ``inertia`` kg m2.

    Two ascending parameters (``Effect.ascending``) start at a ratio of ``apart`` at least.
    """
    given = [scaled(p, kp, inertia) for p in effect.parameters]
    low, high, unit = np.array([(p.low, p.high, p.typical) for p in given]).T
    choices = []
    for k, p in enumerate(given):
        usual = SHAPES if k else SIGNED if p.low < 0 else STRENGTHS
        choices.append([start * p.typical for start in p.starts or usual])
    starts = np.array(list(itertools.product(*choices)))
    names = [p.name for p in given]
    if effect.ascending:
        lower, upper = (names.index(name) for name in effect.ascending)
        starts[:, upper] = np.maximum(starts[:, upper], apart * starts[:, lower])
    columns = np.array([COLUMNS.index(f"{effect.name}.{name}") for name in names], dtype=np.int32)
    starts = np.unique(np.clip(starts, low, high), axis=0)
    return Candidate(effect, columns, low, high, unit, starts)


def candidates(effects: Iterable[str], kp: float, inertia: float) -> list[Candidate]:
    """Every effect that may join these, none that ``excludes`` one of them."""
    present = list(effects)
    return [candidate(effect, kp, inertia) for effect in FITTED if may_join(effect, present)]


def may_join(effect: Effect, others: Iterable[str]) -> bool:
    """Whether an effect may be present with others, none of which ``excludes`` it."""
    return not any(effect.excludes(named(other)) for other in others)


@dataclass(frozen=True)
class Screen:
    """Score of every start of every candidate for one fit."""

    candidate: Index  # index of each start's candidate, shape (S,)
    start: Index  # index of the start within the candidate, shape (S,)
    # standard score of the effect's response in the innovations, after the free parameters have
    # taken up what they can, shape (S,)
    score: Array
    blocks: Array  # contribution of each block to the score, shape (B, S)
    visible: Array  # score that an effect of just this strength would have, shape (S,)
    count: float  # samples that count

    @property
    def gain(self) -> Array:
        """Gain in log-likelihood by each start, its strength free but not its sign, shape (S,)."""
        share = np.minimum(np.maximum(self.score, 0) ** 2 / self.count, 1 - 1e-9)
        return np.asarray(-0.5 * self.count * np.log1p(-share))

    def threshold(
        self, level: float, rng: np.random.Generator, draws: int = 999, starts: Mask | None = None
    ) -> float:
        """Gain that the best of some starts exceeds by chance, with probability ``level``.

        The innovations of whole blocks change sign at random, which keeps what correlation and
        change of variance the noise model has missed (the wild bootstrap: Davidson, Flachaire,
        Journal of Econometrics 146 (2008) 162-169). The tail beyond the draws is Gumbel's.
        """
        blocks = self.blocks if starts is None else self.blocks[:, starts]
        centred = blocks - blocks.mean(axis=0)
        signs = rng.choice([-1.0, 1.0], size=(draws, centred.shape[0]))
        largest = np.maximum(signs @ centred, 0).max(axis=1) ** 2 / 2
        scale = float(largest.std() * np.sqrt(6) / np.pi)
        place = float(largest.mean() - np.euler_gamma * scale)
        tail = place - scale * float(np.log(-np.log1p(-level)))
        return max(tail, float(np.quantile(largest, 1 - level)))


def screen(
    batch: Batch, fits: Fits, candidates: Sequence[list[Candidate]], *, blocks: int = 20
) -> list[Screen]:
    """Look at the candidates of every fit, with ``blocks`` blocks of each recording."""
    own = variants(fits.servos)
    free = own.theta.shape[1]
    N, most = len(candidates), max(sum(len(c.starts) for c in some) for some in candidates)
    theta = np.repeat(own.theta[:, :1], free + most, axis=1)
    theta[:, :free] = own.theta
    scale = np.zeros((N, free + most))
    scale[:, :free] = own.scale
    for n, some in enumerate(candidates):
        at = free
        for c in some:
            theta[n, at : at + len(c.starts), c.columns] = c.starts.T
            at += len(c.starts)
        scale[n, free:at] = 1.0
    problems = Problems(fits.servos.joint, theta, scale)
    seen = batch.evaluate(problems, blocks=blocks, deep=free, autoregression=fits.autoregression)
    screens = []
    for n, some in enumerate(candidates):
        counts = [len(c.starts) for c in some]
        own_starts = np.concatenate([np.arange(number) for number in counts])
        rows, count = np.s_[free : free + sum(counts)], float(seen.count[n])
        scores = _scores(seen.gram[n], seen.square[n, rows], count, free, rows)
        screens.append(Screen(np.repeat(np.arange(len(some)), counts), own_starts, *scores, count))
    return screens


def _scores(
    gram: Array, square: Array, count: float, free: int, starts: slice
) -> tuple[Array, Array, Array]:
    """Scores of starts, the parts of them by block, and the scores that they would have."""
    total = gram.sum(axis=0)
    noise = np.sqrt(total[0, 0] / count)
    inverse = np.linalg.pinv(total[1:free, 1:free], rcond=1e-10, hermitian=True)
    # Directions that the free parameters take up whole say nothing, nor servos that diverged.
    with np.errstate(over="ignore", invalid="ignore"):
        cross = total[1:free, starts]
        taken = inverse @ cross
        norm2 = square - np.einsum("fs,fs->s", cross, taken)
        seen = norm2 > 1e-6 * square + 1e-30
        norm = np.sqrt(np.where(seen, norm2, 1.0))
        along = gram[:, 0, starts] - gram[:, 0, 1:free] @ taken
        pieces = np.where(seen, -along / (norm * noise), 0.0)
    return pieces.sum(axis=0), pieces, np.where(seen, norm / noise, 0.0)


def with_effects(
    plain: Servos, effects: Set, theta: Array, inertia: float, fixed: Set = frozenset()
) -> Servos:
    """A servo whose gains, latency, line and parameters of effects are free, from a row (P,).

    Effects are scaled to the kp of the plain servo and an inertia in kg m2; those that are
    ``fixed`` stay as they are in ``theta``, and other effects are dropped. The controller's side
    and a branch at 0 stay as well.
    """
    kp = float(plain.theta[0, 0])
    options = [candidate(named(e), kp, inertia) for e in sorted(effects) if named(e).fitted]
    row = np.zeros_like(theta)
    row[:FIRST_EFFECT_COLUMN] = theta[:FIRST_EFFECT_COLUMN]
    for option in options:
        row[option.columns] = theta[option.columns]
    own, added = own_parameters(plain), [x for x in options if x.effect.name not in fixed]
    columns, unit, low, high = (
        np.concatenate([getattr(plain, name)[0, own], *(getattr(x, name) for x in added)])
        for name in ("columns", "unit", "low", "high")
    )
    held = np.isin(columns, BRANCH_COLUMNS) & (np.isin(columns, SIDE_COLUMNS) | (row[columns] == 0))
    free = (x[~held][None] for x in (columns, unit, low, high))
    return Servos(plain.joint, row[None], *free)


def own_parameters(servos: Servos) -> Mask:
    """Which of one servo's free parameters are no effect's, shape (F,)."""
    columns = servos.columns[0]
    return np.asarray((columns >= 0) & (columns < FIRST_EFFECT_COLUMN))


def as_read(theta: Array, members: Set) -> Array:
    """A row (P,) whose waves of the angle are as the sensor shows them, where its errors leave.

    Where a gain or an offset of the sensor is not among the members, what stands for it bends the
    servo as much. No fit mends a period that is off by some of its waves.
    """
    gain, offset = (
        0.0 if effect in members else theta[COLUMNS.index(f"{effect}.{name}")]
        for effect, name in _SENSOR.items()
    )
    row = theta.copy()
    for period, phase in _WAVES:
        if row[period] > 0 and (gain or offset):
            row[period] *= 1 + gain
            turned = row[phase] - 2 * np.pi * offset / row[period]
            row[phase] = (turned + np.pi) % (2 * np.pi) - np.pi
    return row
