"""A short formula for a torque that no effect in the catalogue explains: a guess, no finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sim2real.diagnose.linear import Response, gain_torques, through
from sim2real.diagnose.terms import State, Term, terms
from sim2real.diagnose.unknown import wander_filter

Array = NDArray[np.float64]

MOST_TERMS = 2
LEAST_SHARE = 0.1
"""Share of the unseen error's square, before any term, that one must take away to be written."""
_STRETCHES = 4
_GAINS = 3


@dataclass(frozen=True)
class Left:
    """What a fitted servo leaves of one recording.

    Attributes:
        residual: Simulated minus measured angle in rad, 0 where none was measured, shape (T,).
        counts: Samples that count, shape (T,).
        measured: How the joint moved.
        simulated: How the servo moved.
        command: Set-points in rad, shape (T,).
        servo: Gain kp in N m/rad and latency in s.
        response: Filter from a torque to the angle.
    """

    residual: Array
    counts: NDArray[np.bool_]
    measured: State
    simulated: State
    command: Array
    servo: tuple[float, float]
    response: Response


def formula(given: Sequence[Left], torque_unit: str) -> str:
    """The one or two terms that explain most of what is left, or nothing where none generalises.

    With the measured motion, the servo's own equation gives ``measured - simulated`` as the
    response of the linear servo to the missing torque, so each term is one column of a least
    squares problem, beside changes of kp, kd and latency. Terms are added one at a time (stepwise
    sparse regression as in Boninsegna, Nüske, Clementi, Journal of Chemical Physics 148 (2018)
    241723), as long as the error on recordings that were left out falls. There the terms follow
    the simulated motion: those of a measured motion have seen what they are to predict. Residuals
    are whitened for the noise and slow wander of a sensor.

    Args:
        given: The joint's recordings.
        torque_unit: ``"N m"``.

    Returns:
        ``"−0.031 N m · sgn(speed) + 0.2 N m/rad³ · position³"``, or nothing.
    """
    problem = _problem(given)
    chosen: list[int] = []
    error2 = whole = _unseen(problem, chosen)
    while len(chosen) < MOST_TERMS:
        left = [k for k in range(len(problem.terms)) if k not in chosen]
        scores = [_unseen(problem, [*chosen, k]) for k in left]
        best = int(np.argmin([score.sum() for score in scores]))
        better = scores[best] < error2
        # A term that helps in one recording and harms in the rest is chance.
        removed = error2.sum() - scores[best].sum()
        if removed < LEAST_SHARE * whole.sum() or better.mean() <= 0.5:
            break
        chosen.append(left[best])
        error2 = scores[best]
    if not chosen:
        return ""
    weights = _solve(problem.measured[:, problem.places(chosen)], problem.target)
    parts = [
        _part(x, problem.terms[k], torque_unit)
        for x, k in zip(weights[_GAINS:], chosen, strict=True)
    ]
    text = " ".join(f"{sign} {part}" for sign, part in parts)
    return text.removeprefix("+ ") if parts[0][0] == "+" else text.replace("− ", "−", 1)


@dataclass(frozen=True)
class _Problem:
    """Whitened least squares.

    Attributes:
        target: What is to be explained, shape (N,).
        measured: Columns of the gains and of the terms along the measured motion, (N, 3 + K).
        simulated: The same along the simulated motion.
        fold: Part of the data that each row belongs to, shape (N,).
        terms: The K terms.
    """

    target: Array
    measured: Array
    simulated: Array
    fold: NDArray[np.intp]
    terms: list[Term]

    def places(self, chosen: Sequence[int]) -> list[int]:
        """Columns of the gains and of some terms."""
        return [*range(_GAINS), *(_GAINS + k for k in chosen)]


def _problem(given: Sequence[Left]) -> _Problem:
    rows = [[_rows(left, state) for left in given] for state in ("measured", "simulated")]
    targets = [_white(left, -left.residual[:, None])[:, 0] for left in given]
    folds = []
    for r, left in enumerate(given):
        stretch = np.arange(left.counts.size) * _STRETCHES // left.counts.size
        fold = stretch if len(given) == 1 else np.full(left.counts.size, r)
        folds.append(fold[left.counts])
    measured, simulated = (np.concatenate(some) for some in rows)
    listed = terms(given[0].measured)
    return _Problem(np.concatenate(targets), measured, simulated, np.concatenate(folds), listed)


def _rows(left: Left, which: str) -> Array:
    state: State = getattr(left, which)
    gains = gain_torques(state.t, left.command, state.position, left.servo)
    torque = np.column_stack([gains, *(term.value for term in terms(state))])
    return _white(left, through(torque, left.response))


def _white(left: Left, columns: Array) -> Array:
    numerator, denominator, _ = wander_filter(float(np.median(np.diff(left.measured.t))))
    return np.asarray(lfilter(numerator, denominator, columns, axis=0)[left.counts])


def _unseen(problem: _Problem, chosen: Sequence[int]) -> Array:
    """Squared error of each fold by a fit to the others, shape (folds,)."""
    places, errors = problem.places(chosen), []
    fitted, scored = problem.measured[:, places], problem.simulated[:, places]
    for fold in np.unique(problem.fold):
        out = problem.fold == fold
        weight = _solve(fitted[~out], problem.target[~out])
        errors.append(float(np.sum((problem.target[out] - scored[out] @ weight) ** 2)))
    return np.array(errors)


def _solve(design: Array, target: Array) -> Array:
    size = np.sqrt((design**2).sum(axis=0)) + 1e-300
    scaled = design / size
    # Terms overlap with the gains and with each other; a little ridge decides between them.
    normal = scaled.T @ scaled + 1e-7 * np.eye(size.size)
    return np.asarray(np.linalg.solve(normal, scaled.T @ target) / size)


def _part(factor: float, term: Term, torque_unit: str) -> tuple[str, str]:
    """Sign and the rest: ``("−", "0.031 N m · sgn(speed)")``."""
    unit = "" if term.unit is None else f" {torque_unit}{term.unit}"
    words = "" if term.words == "1" else f" · {term.words}"
    return "−" if factor < 0 else "+", f"{abs(factor):.2g}{unit}{words}"
