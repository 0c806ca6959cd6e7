"""What each change would explain of a case, beside what two runs of one servo differ by anyway.

A change is a parameter of the servo that is set anew, or an effect of the catalogue that is added.
Each is fitted to the case with the parameters of the references' servo, in one problem. What runs
differ by (``BETWEEN_RUNS``) is integrated over: residuals along its directions count less.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from sim2real.effects.effect import is_limit
from sim2real.identification.priors import LOG_UNIT, motor_prior, of_effects
from sim2real.identification.search import search
from sim2real.identification.servo_problem import Set
from sim2real.inference.least_squares import OUTLIER_SD, robust_scale
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, LINE, LOSSES, ROTOR

RATIOS = {"kp": BASE[0], "kd": BASE[1], "stall_torque": LINE[0], "no_load_speed": LINE[1]}
"""Parameters that may be set anew, by a ratio."""
LATENCY, LOAD = "latency", "load"
_LOAD = (BASE[3], BASE[4])
BETWEEN_RUNS = {BASE[0]: 0.03, BASE[1]: 0.05, ROTOR: 0.13} | dict.fromkeys(LOSSES[1:4], 0.1)
"""Standard deviations by which parameters differ between runs of one servo, relative."""
LATENCY_BETWEEN_RUNS_S = 0.003
LAW_ERROR_S = 0.5
"""Time over which the error of a law persists."""
FRICTION_SHARE = 0.4
"""Largest friction that is plausible, as a share of the torque that a data sheet states."""
_STARTS = (0.5, 0.75, 1.33, 2.0)


@dataclass(frozen=True)
class Changes(SameSteps):
    """Recordings, what may have changed, and what runs differ by.

    Residuals are in standard deviations of the noise, of as many samples as are independent.

    Attributes:
        weight: Of the residuals, 1/rad, shape (n,).
        times: Samples per independent sample, shape (n,).
        usual: Variance of the noise, rad2, shape (n,).
        count: Independent samples, in the noise of the references.
        trust: Share of the information that counts, as more is left than in references.
        along: Orthonormal directions of the residual in which runs differ, shape (n, K).
        lost: Share of the residual that does not count along each, shape (K,).
    """

    weight: Array | float = 1.0
    times: Array | float = 1.0
    usual: Array | float = 1.0
    count: float = 0.0
    trust: float = 1.0
    along: Array | None = None
    lost: Array | None = None

    def _errors(self, rows: Array, substeps: Array) -> Array:
        errors = super()._errors(rows, substeps) * self.weight
        if self.along is None or self.lost is None:
            return errors
        return np.asarray(errors - (errors @ self.along * self.lost) @ self.along.T)

    def terms(self, x: Array) -> Array:
        """The prior's residuals; weight and inertia of another load change together."""
        parts = super().terms(x)
        if set(_LOAD) <= set(self.names):
            first, second = (self.names.index(name) for name in _LOAD)
            parts[:, first] -= parts[:, second]
            parts[:, first] *= DECISION.change.load_sd / DECISION.change.shape_sd
        return parts

    def differing(self, more: Array | None = None) -> Changes:
        """The same where runs differ as usual, and by ``more`` (n, M) in one standard deviation."""
        rows = [self.row.copy() for _ in range(len(BETWEEN_RUNS) + 1)]
        for row, (name, sd) in zip(rows, BETWEEN_RUNS.items(), strict=False):
            row[COLUMNS.index(name)] *= 1 + sd
        rows[-1][2] += LATENCY_BETWEEN_RUNS_S
        moved = replace(self, along=None).row_residuals(np.array([self.row, *rows]))
        moved = (moved[1:] - moved[:1]).T
        place = np.repeat(np.arange(len(self.traces)), [int(t.used.sum()) for t in self.traces])
        late = moved[:, -1:] * (place[:, None] == np.arange(len(self.traces)))
        parts = [moved[:, :-1], late]
        if more is not None:
            parts.append(more * np.reshape(self.weight, (-1, 1)))
        along, size, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
        return replace(self, along=along, lost=1 - 1 / np.sqrt(1 + size**2))

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
        self,
        noise: Array,
        inflation: Sequence[float],
        law_error: float = DECISION.change.law_error,
    ) -> Changes:
        """The same in this ``noise`` (``noise_of``), with an inflation of each recording.

        A law is wrong by a share of what it explains, here of the error round about.
        """
        bare = replace(self, weight=1.0, along=None)
        sizes, law = [], []
        for error, trace in zip(bare.by_trace(bare.error), self.traces, strict=True):
            samples = max(round(LAW_ERROR_S / trace.period_s), 1)
            sizes.append(error.size)
            law.append(samples * uniform_filter1d(error**2, samples))
        usual, times = noise[0] + noise[1] * self.speed**2, np.repeat(inflation, sizes)
        variance = usual * times + law_error**2 * np.concatenate(law)
        count = float(np.sum(usual / variance))
        return replace(self, weight=1 / np.sqrt(variance), times=times, usual=usual, count=count)

    def left(self, error: Array) -> tuple[float, float]:
        """Mean squares of residuals (n,), robust: in that of the noise, and of the law's error too.

        The first is of as many samples as there are.
        """
        bare = error / self.weight / np.sqrt(self.usual)
        all_in = error * np.sqrt(self.times / self.trust)
        return robust_scale(bare) ** 2, robust_scale(all_in) ** 2


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
    """Changes, fitted to the case."""

    names: tuple[str, ...]  # what has changed
    row: Array  # the case's servo, shape (P,)
    gain: float  # of log-likelihood, prior included, in the references' noise
    occam: float  # cost of its parameters in log-evidence
    left: float  # mean square that it leaves, robust, in that of the noise and the law's error
    bare: float  # the same in that of the noise alone
    trust: float  # share of a gain that counts, as what no change explains is left
    sizes: dict[str, dict[str, Estimate]]  # its parameters by change and name

    @property
    def evidence(self) -> float:
        """Logarithm of the marginal likelihood, over that of no change."""
        return self.gain - self.occam


class Comparison:
    """The case of a joint, its references, and every change that may explain the one."""

    def __init__(self, of: Explained, servo: Servo) -> None:
        self.of, self.servo, R = of, servo, of.references
        self.load = of.traces[-1].load  # of the case, as stated
        self.least = min((t.load for t in of.traces), key=lambda load: load.inertia_kgm2)
        self.inertia = self.least.inertia_kgm2
        every = [Changes((trace,), of.row, ()) for trace in of.traces]
        known = [r for r in range(R) if of.traces[r].used.any()]
        noise, times = np.array([of.least_sd**2, 0.0]), dict.fromkeys(known, 1.0)
        error = {r: every[r].error for r in known}
        for _ in range(2 if known else 0):
            speed = np.concatenate([every[r].speed for r in known])
            noise = noise_of(np.concatenate([error[r] for r in known]), speed, of.least_sd)
            for r in known:
                one = every[r].weighted(noise, [times[r]]).differing()
                times[r], error[r] = one.inflation(one.error), one.error / one.weight
        usual = float(np.mean(list(times.values()))) if known else 1.0
        inflation = [
            max(float(np.mean([times[q] for q in mates if q in times] or [usual])), usual)
            for mates in of.mates
        ]
        floors = [t.noise_floor_rad for t in of.traces[:R]]
        self.misfit = max(0.0, 1 - max(floors) ** 2 / float(noise[0])) if of.way == "law" else 0.0
        self.noise, self.usual = noise, usual
        self.references = [
            every[r].weighted(noise, inflation[r : r + 1]).differing() for r in known
        ]
        case = Changes(of.traces[R:], of.row, ()).weighted(noise, inflation[R:])
        self.law_sd = self._law_sd() if of.way == "law" else None
        self.case = case.differing(self.law_sd)
        self.start_bare, self.start = self.case.left(self.case.error)

    def doubt(self, best: Fitted) -> None:
        """Let the case count less, by what the best explanation leaves of it."""
        case, trust = self.case, best.trust
        case = replace(case, weight=case.weight * trust**0.5, trust=case.trust * trust)
        self.case = case.differing(self.law_sd)

    def _law_sd(self) -> Array:
        """What the parameters of the law move in the case, one standard deviation each, (n, F)."""
        used = [n for n, x in zip(COLUMNS, self.of.row, strict=True) if n in BASE[:3] or x > 0]
        free, R = motor_prior(self.servo, self.of.traces).of(used), self.of.references
        known = Changes(self.of.traces[:R], self.of.row, free)
        known = known.weighted(self.noise, [self.usual] * R)
        x = known.searched(self.of.row[None])
        slopes, (prior,) = known.slopes(x)[1][0], known.prior_slopes(x)[1]
        precision = slopes.T @ slopes + prior.T @ prior
        size, turn = np.linalg.eigh(precision)
        root = turn / np.sqrt(np.maximum(size, 1e-9 * size.max()))
        slopes = Changes(self.of.traces[R:], self.of.row, free).slopes(x)[1][0]
        return np.asarray(slopes @ root)

    def parameters(self, name: str, row: Array) -> tuple[Parameter, ...]:
        """What is fitted where this has changed, with its prior, for a servo ``row`` (P,)."""
        numbers, load = DECISION.change, self.load
        if name in RATIOS:
            value = float(self.of.row[COLUMNS.index(RATIOS[name])])
            ends = value / 20, value * 20, LOG_UNIT, float(np.log(value))
            return (Parameter(RATIOS[name], *ends, numbers.ratio_sd, log=True),)
        if name == LATENCY:
            usual = float(self.of.row[2])
            return (Parameter(BASE[2], 0.0, 0.5, 0.01, usual, numbers.latency_sd_s),)
        if name == LOAD:
            sizes = zip(_LOAD, (load.inertia_kgm2, load.gravity_Nm), strict=True)
            return tuple(
                Parameter(n, -0.9 * x, 9.0 * x, 0.3 * x, 0.0, numbers.load_sd * x) for n, x in sizes
            )
        effect, sd = named(name), DECISION.prior_sd
        free = []
        for k, p in enumerate(of_effects([effect], self.of.row, self.inertia)):
            absent = k == 0 and not is_limit(effect.parameters[0])
            most = p.high
            if effect.site in ("load", "friction") and p.name.endswith("torque_Nm"):
                share = 1.0 if effect.load else FRICTION_SHARE
                known = load is not PER_INERTIA
                most = min(p.high, share * self.servo.max_torque_Nm) if known else most
            low = max(p.low, -most) if p.low < 0 else min(p.low, 0.5 * most)
            middle = 0.0 if absent else p.nominal
            free.append(replace(p, low=low, high=most, nominal=middle, prior_sd=sd * p.typical))
        return tuple(free)

    def starts(self, row: Array, present: Set = frozenset()) -> tuple[list[str], Array]:
        """Every change beside those ``present`` of a servo ``row`` (P,), and servos with it."""
        names, rows, load = list[str](), list[Array](), self.least

        def add(name: str, values: dict[int, float]) -> None:
            names.append(name)
            rows.append(row.copy())
            rows[-1][list(values)] = list(values.values())

        for name, parameter in RATIOS.items() if self.of.way != "rest" else ():
            k = COLUMNS.index(parameter)
            for ratio in _STARTS if row[k] > 0 else ():
                add(name, {k: row[k] * ratio})
        for later in (-0.01, 0.01, 0.03) if self.of.way != "rest" else ():
            add(LATENCY, {2: max(row[2] + later, 0.0)})
        for ratio in _STARTS if load.gravity_Nm > 0 else ():
            sizes = enumerate((load.inertia_kgm2, load.gravity_Nm), start=3)
            add(LOAD, {k: (ratio - 1) * x for k, x in sizes})
        there = {COLUMNS[k].partition(".")[0] for k in np.flatnonzero(row) if "." in COLUMNS[k]}
        for option in candidates(there - {"motor"}, float(self.of.row[0]), self.inertia):
            for start in option.starts if not option.effect.everywhere else ():
                add(option.effect.name, dict(zip(option.columns.tolist(), start, strict=True)))
        kept = [k for k, name in enumerate(names) if name not in present]
        return [names[k] for k in kept], np.array(rows)[kept]

    def screened(
        self, problem: Changes, row: Array, present: Set = frozenset(), only: Sequence[str] = ()
    ) -> dict[str, tuple[float, Array]]:
        """By change, the gain in log-likelihood along a straight line, and the servo (P,) there.

        Of those that are not ``present``, or ``only`` of some.
        """
        names, rows = self.starts(row, present)
        if only:
            some = [k for k, name in enumerate(names) if name in only]
            names, rows = [names[k] for k in some], rows[some]
        errors = problem.row_residuals(np.vstack([row[None], rows]))
        error, moved = errors[0], np.nan_to_num(errors[1:] - errors[:1])
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * max(robust_scale(error), 1e-9))) ** 2)
        square, slope = (moved**2 * weight).sum(axis=1), -(moved * weight) @ error
        share = slope / np.maximum(square, 1e-300)
        share = np.clip(share, [-1.0 if _either_sign(n) else 0.0 for n in names], 1.0)
        gain = share * slope - 0.5 * share**2 * square
        best: dict[str, tuple[float, Array]] = {}
        for name, one, x, start in zip(names, gain, share, rows, strict=True):
            if one > best.get(name, (-1.0, row))[0]:
                best[name] = float(one), row + x * (start - row)
        return best

    def fitted(self, names: Sequence[str], starts: Sequence[Array]) -> Fitted:
        """Fit changes to the case, from some servos (P,)."""
        free = [p for name in names for p in self.parameters(name, starts[0])]
        problem = replace(self.case, parameters=tuple(free))
        x, loss, _ = search(problem, problem.searched(np.array(starts)), (1.0, 1.0), 40)
        (error,), (slopes,) = problem.slopes(x[:1], rough=False)
        _, (prior,) = problem.prior_slopes(x[:1])
        known, (bare, left) = prior.T @ prior, problem.left(error)
        weight = 1 / np.sqrt(1 + (error / OUTLIER_SD) ** 2)
        trust = 1 / (max(left, 1.0) * max(problem.inflation(error) / self.usual, 1.0))
        trust = min(trust / problem.trust, 1.0)
        precision = known + (slopes * weight[:, None]).T @ slopes * trust
        occam = 0.5 * (np.linalg.slogdet(precision)[1] - np.linalg.slogdet(known)[1])
        sd = np.sqrt(np.diag(np.linalg.pinv(precision, hermitian=True)))
        ends = problem.values(np.clip(x[0] + np.outer((-Z90, 0.0, Z90), sd), *problem.box))
        before = self.case.loss(np.zeros((1, 0)), self.case.error[None], 1.0, 1.0)
        return Fitted(
            tuple(names),
            problem.rows(x[:1])[0],
            0.5 * float(before[0] - loss[0]),
            float(occam),
            left,
            bare,
            trust,
            {name: self._sizes(name, problem.names, ends) for name in names},
        )

    def _sizes(self, name: str, names: Sequence[str], ends: Array) -> dict[str, Estimate]:
        """Values of the parameters of a change; ratios of those that the servo has anyway."""
        own = [p.name for p in self.parameters(name, self.of.row)]
        sizes, load = dict[str, Estimate](), self.load
        for parameter in reversed(own):
            low, middle, high = np.sort(ends[:, names.index(parameter)])
            key, before, more = parameter.partition(".")[2] or parameter, 1.0, 0.0
            if name in RATIOS:
                key, before = "ratio", float(self.of.row[COLUMNS.index(parameter)])
            elif name == LATENCY:
                key, more = "change_s", -float(self.of.row[2])
            elif name == LOAD:
                weight = parameter == _LOAD[1]
                key = "ratio" if weight else "inertia_ratio"
                before = load.gravity_Nm if weight else load.inertia_kgm2
                more = before
            low, middle, high = ((x + more) / before for x in (low, middle, high))
            sizes[key] = Estimate(middle, (high - low) / (2 * Z90), low, high)
        return sizes


def _either_sign(name: str) -> bool:
    return name in SET_ANEW or named(name).either_sign
