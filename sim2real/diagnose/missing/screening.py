"""What would each effect explain of what a fit leaves: a linear look at all of them at once."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.effects import CATALOGUE, named
from sim2real.effects.effect import SHAPES, SIGNED, STRENGTHS, Effect, scaled
from sim2real.identification.servo_problem import Fits, variants
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS

FITTED: tuple[Effect, ...] = tuple(e for e in CATALOGUE if e.fitted and not e.never_named)
"""Effects whose parameters a fit finds, and that may be named."""
NUISANCES: tuple[Effect, ...] = tuple(e for e in CATALOGUE if e.fitted and e.everywhere)
"""What every servo has a little of."""


@dataclass(frozen=True)
class Candidate:
    """One effect as a fit sees it, for a servo of given strength.

    Attributes:
        effect: The effect.
        columns: Columns of its K parameters, shape (K,).
        low: Their smallest values, shape (K,).
        high: Their largest values, shape (K,).
        unit: Their natural sizes, shape (K,).
        starts: Values to start from, shape (S, K).
    """

    effect: Effect
    columns: Integers
    low: Array
    high: Array
    unit: Array
    starts: Array


def candidate(effect: Effect, kp: float, inertia: float, *, apart: float = 1.5) -> Candidate:
    """An effect scaled to a servo of ``kp`` N m/rad on ``inertia`` kg m2.

    Two ascending parameters (``Effect.ascending``) start at a ratio of ``apart`` at least.
    """
    given = [scaled(p, kp, inertia) for p in effect.parameters]
    low, high, unit = (
        np.array([getattr(p, name) for p in given]) for name in ("low", "high", "typical")
    )
    choices = []
    for k, p in enumerate(given):
        usual = SHAPES if k else SIGNED if p.low < 0 else STRENGTHS
        choices.append([start * p.typical for start in p.starts or usual])
    starts = np.array(list(itertools.product(*choices)))
    if effect.ascending:
        names = [p.name for p in given]
        lower, upper = (names.index(name) for name in effect.ascending)
        starts[:, upper] = np.maximum(starts[:, upper], apart * starts[:, lower])
    columns = [COLUMNS.index(f"{effect.name}.{p.name}") for p in given]
    return Candidate(
        effect=effect,
        columns=np.array(columns, dtype=np.int32),
        low=low,
        high=high,
        unit=unit,
        starts=np.unique(np.clip(starts, low, high), axis=0),
    )


def candidates(
    effects: Sequence[str] | frozenset[str], kp: float, inertia: float
) -> list[Candidate]:
    """Every effect that may join these, none that ``excludes`` one of them."""
    present = [named(name) for name in effects]
    return [
        candidate(effect, kp, inertia)
        for effect in FITTED
        if not any(effect.excludes(other) for other in present)
    ]


@dataclass(frozen=True)
class Screen:
    """Score of every start of every candidate for one fit.

    Attributes:
        candidate: Index of each start's candidate, shape (S,).
        start: Index of the start within the candidate, shape (S,).
        score: Standard score of the effect's response in the innovations, after the free
            parameters have taken up what they can, shape (S,).
        blocks: Contribution of each block to the score, shape (B, S).
        visible: Norm of that response in units of the innovation: the score that an effect of
            just this strength would have, shape (S,).
        count: Samples that count.
    """

    candidate: Index
    start: Index
    score: Array
    blocks: Array
    visible: Array
    count: float

    def of(self, wanted: Mask) -> Screen:
        """The starts of some candidates; ``wanted`` has one entry a candidate."""
        some = wanted[self.candidate]
        return replace(
            self,
            candidate=self.candidate[some],
            start=self.start[some],
            score=self.score[some],
            blocks=self.blocks[:, some],
            visible=self.visible[some],
        )

    @property
    def gain(self) -> Array:
        """Gain in log-likelihood by each start, its strength free but not its sign, shape (S,)."""
        share = np.minimum(np.maximum(self.score, 0) ** 2 / self.count, 1 - 1e-9)
        return np.asarray(-0.5 * self.count * np.log1p(-share))

    def threshold(self, level: float, rng: np.random.Generator, draws: int = 999) -> float:
        """Gain that the best start exceeds with probability ``level`` where nothing is missing.

        By turning round the innovations of whole blocks at random, which keeps what correlation
        and change of variance the noise model has missed (the wild bootstrap: Davidson, Flachaire,
        Journal of Econometrics 146 (2008) 162-169). The tail beyond the draws is Gumbel's.
        """
        centred = self.blocks - self.blocks.mean(axis=0)
        signs = rng.choice([-1.0, 1.0], size=(draws, centred.shape[0]))
        # Fast where there are many starts: nothing but one matrix product.
        largest = np.maximum(signs @ centred, 0).max(axis=1) ** 2 / 2
        scale = float(largest.std() * np.sqrt(6) / np.pi)
        place = float(largest.mean() - np.euler_gamma * scale)
        tail = place - scale * float(np.log(-np.log1p(-level)))
        return max(tail, float(np.quantile(largest, 1 - level)))


def screen(
    batch: Batch, fits: Fits, candidates: list[list[Candidate]], *, blocks: int = 20
) -> list[Screen]:
    """Look at all candidates from every fit.

    Args:
        batch: The recordings.
        fits: Fits to start from.
        candidates: For each fit the candidates to look at.
        blocks: Blocks of each recording.
    """
    own = variants(fits.servos)
    free = own.theta.shape[1]
    starts = [sum(len(c.starts) for c in some) for some in candidates]
    N, most = len(candidates), max(starts)
    theta = np.repeat(own.theta[:, :1], free + most, axis=1)
    theta[:, :free] = own.theta
    scale = np.zeros((N, free + most))
    scale[:, :free] = own.scale
    labels = []
    for n, some in enumerate(candidates):
        at = free
        for c in some:
            theta[n, at : at + len(c.starts), c.columns] = c.starts.T
            at += len(c.starts)
        scale[n, free:at] = 1.0
        labels.append(
            (
                np.repeat(np.arange(len(some)), [len(c.starts) for c in some]),
                np.concatenate([np.arange(len(c.starts)) for c in some]),
            )
        )
    seen = batch.evaluate(
        Problems(fits.servos.joint, theta, scale),
        blocks=blocks,
        deep=free,
        autoregression=fits.autoregression,
    )
    return [
        _score(seen.gram[n], seen.square[n], seen.count[n], free, starts[n], *labels[n])
        for n in range(N)
    ]


def _score(
    gram: Array, square: Array, count: float, free: int, starts: int, candidate: Index, start: Index
) -> Screen:
    total = gram.sum(axis=0)
    error2 = total[0, 0]
    normal = total[1:free, 1:free]
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    cross = total[1:free, free : free + starts]
    taken = inverse @ cross
    norm2 = square[free : free + starts] - np.einsum("fs,fs->s", cross, taken)
    noise = np.sqrt(error2 / count)
    # Directions that the free parameters take up whole say nothing.
    seen = norm2 > 1e-6 * square[free : free + starts] + 1e-30
    norm = np.sqrt(np.where(seen, norm2, 1.0))
    along = gram[:, 0, free : free + starts] - gram[:, 0, 1:free] @ taken
    pieces = np.where(seen, -along / (norm * noise), 0.0)
    visible = np.where(seen, norm / noise, 0.0)
    return Screen(candidate, start, pieces.sum(axis=0), pieces, visible, float(count))
