"""What each change would explain of a case, beside what two runs of one servo differ by anyway.

A change is a parameter of the servo that is set anew, or an effect of the catalogue that is added.
Each is fitted to the case with the parameters of the references' servo, in one problem. What runs
differ by (``BETWEEN_RUNS``) is integrated over: residuals along its directions count less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.explained import Explained, SameSteps
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.screening import candidates
from sim2real.effects import SET_ANEW, named
from sim2real.effects.effect import Effect, is_limit
from sim2real.identification.priors import LOG_UNIT, motor_prior, of_effects
from sim2real.identification.problem import Fit
from sim2real.identification.search import search
from sim2real.inference.least_squares import OUTLIER_SD, robust_scale
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, LINE, LOSSES, ROTOR

RATIOS = {"kp": BASE[0], "kd": BASE[1], "stall_torque": LINE[0], "no_load_speed": LINE[1]}
"""Parameters that may be set anew, by a ratio."""
LATENCY, LOAD = "latency", "load"
LOADS = ("gravity_load", "unmodelled_inertia")
"""Effects that together are another load."""
_LOAD = tuple(f"{name}.{named(name).parameters[0].name}" for name in LOADS)
BETWEEN_RUNS = {BASE[0]: 0.03, BASE[1]: 0.05, ROTOR: 0.13} | dict.fromkeys(LOSSES[1:4], 0.1)
"""Standard deviations by which parameters differ between runs of one servo, relative."""
LATENCY_BETWEEN_RUNS_S = 0.003
LAW_ERROR_S = 0.5
"""Time over which the error of a law persists."""
FRICTION_SHARE = 0.4
"""Largest friction that is plausible, as a share of the torque that a data sheet states."""
_RATIOS = np.array([[0.5], [0.75], [1.33], [2.0]])
_LATER_S = np.array([[-0.01], [0.01], [0.03]])
"""Ratios and differences from which changed parameters start."""


@dataclass(frozen=True)
class Kind:
    """A change of K parameters."""

    parameters: tuple[Parameter, ...]  # what is fitted, with its prior
    starts: Array  # values from which it starts, shape (S, K)
    keys: tuple[str, ...]  # what is stated of each: (value - ``zero``) / ``one``
    zero: Array | float = 0.0
    one: Array | float = 1.0

    @property
    def columns(self) -> list[int]:
        """Columns of its parameters."""
        return [COLUMNS.index(p.name) for p in self.parameters]

    def rows(self, row: Array) -> Array:
        """A servo (P,) with the change, from every start, shape (S, P)."""
        rows = np.tile(row, (len(self.starts), 1))
        rows[:, self.columns] = self.starts
        return rows

    def sizes(self, rows: Array) -> dict[str, Estimate]:
        """What is stated of servos (3, P) at the ends and the middle of its intervals."""
        values = np.sort((rows[:, self.columns] - self.zero) / self.one, axis=0).T.tolist()
        return {
            key: Estimate(middle, (high - low) / (2 * Z90), low, high)
            for key, (low, middle, high) in zip(self.keys, values, strict=True)
        }


def set_anew(row: Array, load: Load, *, moving: bool) -> dict[str, Kind]:
    """Parameters of a servo (P,) that may have been set anew; those of motion if it is ``moving``.

    A weight is known only where it pulls.
    """
    kinds, numbers = dict[str, Kind](), DECISION.change
    for name, column in RATIOS.items() if moving else ():
        usual = float(row[COLUMNS.index(column)])
        if usual > 0:
            ends = usual / 20, usual * 20, LOG_UNIT, float(np.log(usual))
            prior = Parameter(column, *ends, numbers.ratio_sd, log=True)
            kinds[name] = Kind((prior,), _RATIOS * usual, ("ratio",), one=usual)
    if moving:
        usual = float(row[2])
        prior = Parameter(BASE[2], 0.0, 0.5, 0.01, usual, numbers.latency_sd_s)
        kinds[LATENCY] = Kind((prior,), np.maximum(usual + _LATER_S, 0.0), ("change_s",), usual)
    if load.gravity_Nm > 0:
        stated = np.array([load.gravity_Nm, load.inertia_kgm2])
        before = row[[COLUMNS.index(name) for name in _LOAD]]
        priors = tuple(
            Parameter(name, x - 0.9 * one, x + 9.0 * one, 0.3 * one, x, numbers.load_sd * one)
            for name, x, one in zip(_LOAD, before.tolist(), stated.tolist(), strict=True)
        )
        starts, keys = before + (_RATIOS - 1) * stated, ("ratio", "inertia_ratio")
        kinds[LOAD] = Kind(priors, starts, keys, before - stated, stated)
    return kinds


def effect_priors(effect: Effect, row: Array, load: Load, servo: Servo) -> tuple[Parameter, ...]:
    """Parameters of an effect that is added to a servo (P,), none of them beyond its torque."""
    priors = []
    for k, p in enumerate(of_effects([effect], row, load.inertia_kgm2)):
        absent, most = k == 0 and not is_limit(effect.parameters[0]), p.high
        is_torque = effect.site in ("load", "friction") and p.name.endswith("torque_Nm")
        if is_torque and load is not PER_INERTIA:
            most = min(most, (1.0 if effect.load else FRICTION_SHARE) * servo.max_torque_Nm)
        low = max(p.low, -most) if p.low < 0 else min(p.low, 0.5 * most)
        middle, sd = 0.0 if absent else p.nominal, DECISION.prior_sd * p.typical
        priors.append(replace(p, low=low, high=most, nominal=middle, prior_sd=sd))
    return tuple(priors)


@dataclass(frozen=True)
class Changes(SameSteps):
    """Recordings, what may have changed, and what runs differ by.

    Residuals are in standard deviations of the noise, of as many samples as are independent.
    """

    weight: Array | float = 1.0  # of the residuals, 1/rad, shape (n,)
    # directions of the residual in which runs differ, with the share that does not count, (n, K)
    along: Array | None = None

    def _errors(self, rows: Array, substeps: Array) -> Array:
        errors = super()._errors(rows, substeps) * self.weight
        return errors if self.along is None else errors - (errors @ self.along) @ self.along.T

    def terms(self, x: Array) -> Array:
        """The prior's residuals; weight and inertia of another load change together."""
        parts = super().terms(x)
        if set(_LOAD) <= set(self.names):
            first, second = (self.names.index(name) for name in _LOAD)
            parts[:, first] -= parts[:, second]
            parts[:, first] *= DECISION.change.load_sd / DECISION.change.shape_sd
        return parts

    @cached_property
    def error(self) -> Array:
        """What the references' servo leaves, shape (n,)."""
        return np.asarray(self.row_residuals(self.row[None])[0])

    @cached_property
    def speed(self) -> Array:
        """Of the references' servo at the used samples, rad/s, shape (n,)."""
        bare = replace(self, weight=1.0, along=None)
        parts = zip(bare.by_trace(bare.error), self.traces, strict=True)
        return np.concatenate([np.gradient(e + t.position[t.used], t.t[t.used]) for e, t in parts])

    def weighted(
        self, noise: Array, times: float, law_error: float = DECISION.change.law_error
    ) -> Changes:
        """The same in this noise (``noise_of``), of which so many samples are as good as one.

        A law is wrong by a share of what it explains, here of the error round about.
        """
        bare, around = replace(self, weight=1.0, along=None), []
        for error, trace in zip(bare.by_trace(bare.error), self.traces, strict=True):
            samples = max(round(LAW_ERROR_S / trace.period_s), 1)
            around.append(samples * uniform_filter1d(error**2, samples))
        variance = (noise[0] + noise[1] * self.speed**2) * times
        variance += law_error**2 * np.concatenate(around)
        return replace(self, weight=1 / np.sqrt(variance))

    def differing(self, more: Array | None = None) -> Changes:
        """The same where runs differ as usual, and by ``more`` (n, M) in one standard deviation."""
        rows = np.tile(self.row, (len(BETWEEN_RUNS) + 2, 1))
        for row, (name, sd) in zip(rows[1:], BETWEEN_RUNS.items(), strict=False):
            row[COLUMNS.index(name)] *= 1 + sd
        rows[-1, 2] += LATENCY_BETWEEN_RUNS_S
        moved = replace(self, along=None).row_residuals(rows)
        moved = (moved[1:] - moved[:1]).T
        place = np.repeat(np.arange(len(self.traces)), [int(t.used.sum()) for t in self.traces])
        late = moved[:, -1:] * (place[:, None] == np.arange(len(self.traces)))
        parts = [moved[:, :-1], late]
        if more is not None:
            parts.append(more * np.reshape(self.weight, (-1, 1)))
        along, size, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
        return replace(self, along=along * np.sqrt(1 - 1 / np.sqrt(1 + size**2)))


def screened(
    problem: Changes, row: Array, kinds: Mapping[str, Kind]
) -> dict[str, tuple[float, Array]]:
    """Gain in log-likelihood by each change along a straight line, and the servo (P,) there.

    Of changes of a servo ``row`` (P,), the largest gain first.
    """
    names = [name for name, kind in kinds.items() for _ in kind.starts]
    rows = np.vstack([row[None], *(kind.rows(row) for kind in kinds.values())])
    errors = problem.row_residuals(rows)
    error, moved = errors[0], np.nan_to_num(errors[1:] - errors[:1])
    weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * max(robust_scale(error), 1e-9))) ** 2)
    square, slope = (moved**2 * weight).sum(axis=1), -(moved * weight) @ error
    either_sign = [name in SET_ANEW or named(name).either_sign for name in names]
    share = np.clip(slope / np.maximum(square, 1e-300), np.where(either_sign, -1.0, 0.0), 1.0)
    gain = share * slope - 0.5 * share**2 * square
    best = dict[str, tuple[float, Array]]()
    for k in np.argsort(-gain, kind="stable"):
        if np.isfinite(gain[k]):  # else it diverges
            best.setdefault(names[k], (float(gain[k]), row + share[k] * (rows[1 + k] - row)))
    return best


def noise_of(error: Array, speed: Array, least_sd: float, *, rounds: int = 10) -> Array:
    """Variance of residuals (n,) at rest, rad2, and what a squared speed (n,) adds to it, s2.

    Times of reading jitter, so that noise grows with speed.
    """
    terms = np.stack([np.ones(error.size), speed**2], axis=1)
    noise = np.array([robust_scale(error) ** 2, 0.0])
    for _ in range(rounds):
        variance = np.maximum(terms @ noise, least_sd**2)
        limited = np.minimum(error**2, OUTLIER_SD**2 * variance)
        noise = nnls(terms / variance[:, None], limited / variance)[0]
    return np.array([max(noise[0], least_sd**2), noise[1]])


@dataclass(frozen=True)
class Fitted:
    """Changes, fitted to the case; in its noise and the law's error."""

    names: tuple[str, ...]  # what has changed
    fit: Fit  # the case's servo
    gain: float  # of log-likelihood, prior included
    evidence: float  # logarithm of the marginal likelihood, over that of no change
    left: tuple[float, float]  # mean squares that it leaves, see ``Comparison.left``
    sizes: Mapping[str, Mapping[str, Estimate]]  # its parameters by change and name


@dataclass(frozen=True)
class Comparison:
    """The case of a joint, its references, and every change that may explain the one."""

    of: Explained
    servo: Servo
    load: Load  # the smallest, as stated
    noise: Array  # of the references, see ``noise_of``
    times: float  # samples of it per independent sample
    references: tuple[Changes, ...]  # those that count, each by itself
    case: Changes  # recordings in question
    law_sd: Array | None  # what the law's parameters move in them, one sd each, rad, (n, F)
    trust: float = 1.0  # share of the case's information that counts

    @cached_property
    def _usual(self) -> Array:
        return np.asarray(self.noise[0] + self.noise[1] * self.case.speed**2)

    @property
    def count(self) -> float:
        """Independent samples of the case, in the noise of the references."""
        return float(np.sum(self._usual * np.square(self.case.weight)))

    def left(self, error: Array) -> tuple[float, float]:
        """Mean squares of residuals (n,) of the case, robust: in that of the noise and law's error.

        The second in that of the noise alone.
        """
        bare = error / self.case.weight / np.sqrt(self._usual)
        all_in = error * np.sqrt(self.times / self.trust)
        return robust_scale(all_in) ** 2, robust_scale(bare) ** 2

    @cached_property
    def start(self) -> tuple[float, float]:
        """What no change leaves."""
        return self.left(self.case.error)

    def doubted(self, best: Fitted) -> Comparison:
        """The same, where the case counts less, by what the best explanation leaves of it."""
        correlated = best.fit.problem.inflation(best.fit.error) / self.times
        trust = 1 / (max(best.left[0], 1.0) * max(correlated, 1.0))
        case = replace(self.case, weight=self.case.weight * trust**0.5)
        return replace(self, case=case.differing(self.law_sd), trust=trust)

    @cached_property
    def every(self) -> dict[str, Kind]:
        """Every change of the references' servo."""
        return self.joining(self.of.row)

    def joining(self, row: Array, present: str | None = None) -> dict[str, Kind]:
        """Changes that may join a servo ``row`` (P,) that has one already, or none."""
        own = self.of.row
        kinds = set_anew(own, self.load, moving=self.of.way != "rest")
        there = {COLUMNS[k].partition(".")[0] for k in np.flatnonzero(row) if "." in COLUMNS[k]}
        for option in candidates(there - {"motor"}, float(own[0]), self.load.inertia_kgm2):
            if not option.effect.everywhere:
                priors = effect_priors(option.effect, own, self.load, self.servo)
                keys = tuple(p.name.partition(".")[2] for p in priors)
                kinds[option.effect.name] = Kind(priors, option.starts, keys)
        taken = self.every[present].columns if present else ()
        return {name: kind for name, kind in kinds.items() if not {*kind.columns} & {*taken}}

    def fitted(self, names: Sequence[str], starts: Sequence[Array]) -> Fitted:
        """Fit changes to the case, from some servos (P,)."""
        free = tuple(p for name in names for p in self.every[name].parameters)
        problem = replace(self.case, parameters=free)
        x, loss, _ = search(problem, problem.searched(np.array(starts)), (1.0, 1.0), 40)
        (error,), (slopes,) = problem.slopes(x[:1], rough=False)
        fit = Fit(problem, x[0], error, slopes, 1.0, 1.0, True, x[1:], loss[1:] - loss[0])
        none = np.zeros((1, 0)), self.case.error[None]
        before = 0.5 * float(self.case.loss(*none, 1.0, 1.0)[0])
        sd = np.sqrt(np.diag(np.linalg.pinv(fit.information(), hermitian=True)))
        ends = problem.rows(np.clip(x[0] + np.outer((-Z90, 0.0, Z90), sd), *problem.box))
        return Fitted(
            names=tuple(names),
            fit=fit,
            gain=before - 0.5 * float(loss[0]),
            evidence=before + fit.evidence(1.0, 1.0),
            left=self.left(error),
            sizes={name: self.every[name].sizes(ends) for name in names},
        )


def compared(of: Explained, servo: Servo) -> Comparison:
    """A case and its references, in the noise that the references show among themselves."""
    known = [trace for trace in of.traces[: of.references] if trace.used.any()]
    every = [Changes((trace,), of.row, ()) for trace in known]
    noise, times = np.array([of.least_sd**2, 0.0]), np.ones(max(len(known), 1))
    errors = [one.error for one in every]
    for _ in range(2 if known else 0):
        speed = np.concatenate([one.speed for one in every])
        noise = noise_of(np.concatenate(errors), speed, of.least_sd)
        weighted = [
            one.weighted(noise, x).differing() for one, x in zip(every, times.tolist(), strict=True)
        ]
        times = np.array([one.inflation(one.error) for one in weighted])
        errors = [one.error / one.weight for one in weighted]
    usual = float(times.mean())
    case = Changes(of.traces[of.references :], of.row, ()).weighted(noise, usual)
    law_sd = _law_sd(of, servo, noise, usual) if of.way == "law" else None
    references = tuple(one.weighted(noise, usual).differing() for one in every)
    load = min((trace.load for trace in of.traces), key=lambda load: load.inertia_kgm2)
    return Comparison(of, servo, load, noise, usual, references, case.differing(law_sd), law_sd)


def _law_sd(of: Explained, servo: Servo, noise: Array, times: float) -> Array:
    """What the parameters of the law move in the case, one standard deviation each, (n, F)."""
    used = [n for n, x in zip(COLUMNS, of.row, strict=True) if n in BASE[:3] or x > 0]
    free, R = motor_prior(servo, of.traces).of(used), of.references
    known = Changes(of.traces[:R], of.row, free).weighted(noise, times)
    x = known.searched(of.row[None])
    slopes, (prior,) = known.slopes(x)[1][0], known.prior_slopes(x)[1]
    size, turn = np.linalg.eigh(slopes.T @ slopes + prior.T @ prior)
    root = turn / np.sqrt(np.maximum(size, 1e-9 * size.max()))
    return np.asarray(Changes(of.traces[R:], of.row, free).slopes(x)[1][0] @ root)
