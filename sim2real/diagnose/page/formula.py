"""A short formula for a torque that no effect in the catalogue explains: a guess, no finding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sim2real.identification.held_out import simulated
from sim2real.inference.correlated_noise import RESIDUAL_WANDER, counting
from sim2real.servo.linearised import Filter, gain_torques, smooth, through, torque_filter
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_GAINS = 3


def what_is_left(
    trace: Trace, residual: Array, theta: Array, others: Mapping[str, Trace], *, lags: int = 3
) -> Left:
    """What a fitted servo leaves of one recording.

    Args:
        trace: The recording.
        residual: Simulated minus measured angle in rad, shape (T,) or longer.
        theta: Parameters of the servo, shape (P,).
        others: The same recording of other joints, by name.
        lags: Samples after a gap that do not count.
    """
    kp, kd, latency = (float(x) for x in theta[:3])
    t, load = trace.t, trace.load
    besides = {name: np.interp(t, other.t, _position(other)) for name, other in others.items()}

    def state(position: Array) -> State:
        asked = kp * (np.interp(t - latency, t, trace.command) - position)
        return State(t - t[0], position, np.gradient(position, t), asked, besides)

    row = np.where(trace.used, residual[: t.size], 0.0)
    step = float(np.median(np.diff(t)))
    return Left(
        residual=row,
        counts=counting(trace.used, lags),
        measured=state(_position(trace)),
        simulated=state(simulated(trace, theta[None])[0]),
        command=trace.command,
        servo=(kp, latency),
        response=torque_filter(load.inertia_kgm2, kd, kp + load.gravity_Nm, step),
    )


def _position(trace: Trace) -> Array:
    return smooth(trace.t, np.where(trace.used, trace.position, np.nan))


@dataclass(frozen=True)
class State:
    """One joint of one recording as it moved.

    Attributes:
        t: Time since the start in s, shape (T,).
        position: Angle in rad, measured and smoothed or simulated, shape (T,).
        speed: Its derivative in rad/s, shape (T,).
        load: Torque that the proportional gain asks for, N m (or per kg m2), shape (T,).
        others: Measured angles of other joints in rad by name, smoothed, shape (T,) each.
    """

    t: Array
    position: Array
    speed: Array
    load: Array
    others: Mapping[str, Array]


@dataclass(frozen=True)
class FormulaTerm:
    """A torque up to its factor.

    Attributes:
        words: ``"sgn(speed)"``.
        unit: What the unit of a torque is followed by in that of the factor, ``"/rad³"``; None
            where the factor has none.
        value: Moment by moment, shape (T,).
    """

    words: str
    unit: str | None
    value: Array


def terms(
    state: State,
    *,
    waves_per_rad: tuple[int, ...] = (2, 3, 4, 6, 8, 12, 16),
    small_speed_rad_s: float = 0.05,
) -> list[FormulaTerm]:
    """All of them, in the same order for every recording.

    Speed alone and distance from the command are not among them: they are the servo's own gains.
    Neither is acceleration: with them it would be the servo's whole equation, true of any motion.
    """
    q, v, t = state.position, state.speed, state.t
    sign = np.tanh(v / small_speed_rad_s)
    listed = [
        FormulaTerm("1", "", np.ones_like(q)),
        FormulaTerm("position", "/rad", q),
        FormulaTerm("position²", "/rad²", q**2),
        FormulaTerm("position³", "/rad³", q**3),
        FormulaTerm("sgn(speed)", "", sign),
        FormulaTerm("|speed| speed", " s²/rad²", np.abs(v) * v),
        FormulaTerm("speed³", " s³/rad³", v**3),
        FormulaTerm("position · speed", " s/rad²", q * v),
        FormulaTerm("position² · speed", " s/rad³", q**2 * v),
        FormulaTerm("|position| sgn(speed)", "/rad", np.abs(q) * sign),
        FormulaTerm("position · speed²", " s²/rad³", q * v**2),
        FormulaTerm("|load| sgn(speed)", None, np.abs(state.load) * sign),
        FormulaTerm("|load|", None, np.abs(state.load)),
        FormulaTerm("time", "/s", t),
        FormulaTerm("time · position", "/(rad s)", t * q),
        FormulaTerm("time · speed", "/rad", t * v),
        FormulaTerm("time · sgn(speed)", "/s", t * sign),
        FormulaTerm("time · load", None, t * state.load),
    ]
    for k in waves_per_rad:
        listed += [
            FormulaTerm(f"sin({k} position)", "", np.sin(k * q)),
            FormulaTerm(f"cos({k} position)", "", np.cos(k * q)),
        ]
    for name, angle in state.others.items():
        moving = np.gradient(angle, t)
        listed += [
            FormulaTerm(f"speed of {name}", " s/rad", moving),
            FormulaTerm(f"acceleration of {name}", " s²/rad", np.gradient(moving, t)),
        ]
    return listed


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
    response: Filter


def formula(given: Sequence[Left], torque_unit: str, least: float, *, most_terms: int = 2) -> str:
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
        least: Share of the squared error on what was left out that a term must take away.
        most_terms: Terms at most.

    Returns:
        ``"−0.031 N m · sgn(speed) + 0.2 N m/rad³ · position³"``, or nothing.
    """
    problem = _problem(given)
    chosen: list[int] = []
    error2 = whole = _unseen(problem, chosen)
    while len(chosen) < most_terms:
        left = [k for k in range(len(problem.terms)) if k not in chosen]
        scores = [_unseen(problem, [*chosen, k]) for k in left]
        best = int(np.argmin([score.sum() for score in scores]))
        better = scores[best] < error2
        # A term that helps in one recording and harms in the rest is chance.
        removed = error2.sum() - scores[best].sum()
        if removed < least * whole.sum() or better.mean() <= 0.5:
            break
        chosen.append(left[best])
        error2 = scores[best]
    if not chosen:
        return ""
    weights = _solve(problem.measured[:, problem.columns(chosen)], problem.target)
    parts = [
        _part(x, problem.terms[k], torque_unit)
        for x, k in zip(weights[_GAINS:], chosen, strict=True)
    ]
    text = " ".join(f"{sign} {part}" for sign, part in parts)
    return text.removeprefix("+ ") if parts[0][0] == "+" else text.replace("− ", "−", 1)


@dataclass(frozen=True)
class _FormulaFit:
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
    terms: list[FormulaTerm]

    def columns(self, chosen: Sequence[int]) -> list[int]:
        """Columns of the gains and of some terms."""
        return [*range(_GAINS), *(_GAINS + k for k in chosen)]


def _problem(given: Sequence[Left], *, segments: int = 4) -> _FormulaFit:
    rows = [[_rows(left, state) for left in given] for state in ("measured", "simulated")]
    targets = [_white(left, -left.residual[:, None])[:, 0] for left in given]
    folds = []
    for r, left in enumerate(given):
        segment = np.arange(left.counts.size) * segments // left.counts.size
        fold = segment if len(given) == 1 else np.full(left.counts.size, r)
        folds.append(fold[left.counts])
    measured, simulated = (np.concatenate(some) for some in rows)
    target, fold = np.concatenate(targets), np.concatenate(folds)
    return _FormulaFit(target, measured, simulated, fold, terms(given[0].measured))


def _rows(left: Left, which: str) -> Array:
    state: State = getattr(left, which)
    gains = gain_torques(state.t, left.command, state.position, left.servo)
    torque = np.column_stack([gains, *(term.value for term in terms(state))])
    return _white(left, through(torque, left.response))


def _white(left: Left, columns: Array) -> Array:
    numerator, denominator, _ = RESIDUAL_WANDER.filter(float(np.median(np.diff(left.measured.t))))
    return np.asarray(lfilter(numerator, denominator, columns, axis=0)[left.counts])


def _unseen(problem: _FormulaFit, chosen: Sequence[int]) -> Array:
    """Squared error of each fold by a fit to the others, shape (folds,)."""
    columns, errors = problem.columns(chosen), []
    fitted, scored = problem.measured[:, columns], problem.simulated[:, columns]
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


def _part(factor: float, term: FormulaTerm, torque_unit: str) -> tuple[str, str]:
    """Sign and the rest: ``("−", "0.031 N m · sgn(speed)")``."""
    unit = "" if term.unit is None else f" {torque_unit}{term.unit}"
    words = "" if term.words == "1" else f" · {term.words}"
    return "−" if factor < 0 else "+", f"{abs(factor):.2g}{unit}{words}"
