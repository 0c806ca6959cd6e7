"""What each change would explain of a case, beside what two runs of one servo differ by anyway.

A change is a parameter of the servo that is set anew, or an effect of the catalogue that is added.
Each is fitted to the case with the parameters of the references' servo, in one problem. One that is
freed in one reference alone explains something there, though nothing has changed: by this *null
gain* a case is judged, with Student's tails, references being few.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.explained import LOAD_COLUMNS, Changes, Explained, noise_of
from sim2real.diagnose.link_effect import IrregularTiming
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.screening import FITTED, candidates
from sim2real.diagnose.unmodelled import Windows
from sim2real.effects import SET_ANEW, named
from sim2real.effects.effect import is_limit
from sim2real.identification.priors import LOG_UNIT, motor_prior, of_effects
from sim2real.identification.search import search
from sim2real.identification.servo_problem import Set
from sim2real.inference.evidence import student
from sim2real.inference.least_squares import OUTLIER_SD, robust_scale
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, LINE

_MOST = 10
"""Changes, and pairs of them, that are fitted to the case."""
_NEAR = 0.3
"""Share of the best change's evidence from which another one stays in question."""
_HEADS = 3
"""Single changes to which a second one is added."""
_RATIOS = {"kp": BASE[0], "kd": BASE[1], "stall_torque": LINE[0], "no_load_speed": LINE[1]}
"""Parameters that may be set anew, by a ratio."""
_LATENCY, LOAD = "latency", "load"
_FRICTION_SHARE = 0.4
"""Largest friction that is plausible, as a share of the torque that a data sheet states."""
_STARTS = (0.5, 0.75, 1.33, 2.0)


@dataclass(frozen=True)
class Fitted:
    """Changes, fitted to the case."""

    names: tuple[str, ...]  # what has changed
    row: Array  # the case's servo, shape (P,)
    gain: float  # of log-likelihood, prior included, in the references' noise
    evidence: float  # logarithm of the marginal likelihood, over that of no change
    left: float  # mean square that it leaves, robust, in that of the noise and the law's error
    bare: float  # the same in that of the noise alone
    trust: float  # share of a gain that counts, as what no change explains is left
    sizes: dict[str, dict[str, Estimate]]  # its parameters by change and name


class Comparison:
    """The case of a joint, its references, and every change that may explain the one."""

    def __init__(self, of: Explained, servo: Servo) -> None:
        self.of, self.servo, R = of, servo, of.references
        self.load = of.traces[-1].load  # of the case, as stated
        self.least = min((t.load for t in of.traces), key=lambda load: load.inertia_kgm2)
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

    def _parameters(self, name: str) -> list[tuple[Parameter, str, float, float]]:
        """What is fitted where this has changed, with its prior, and how its size x is stated.

        By its name there, and as (x + the last number) / the one before: ratios of what the servo
        has anyway.
        """
        numbers, load, row = DECISION.change, self.load, self.of.row
        if name in _RATIOS:
            value = float(row[COLUMNS.index(_RATIOS[name])])
            ends = value / 20, value * 20, LOG_UNIT, float(np.log(value))
            ratio = Parameter(_RATIOS[name], *ends, numbers.ratio_sd, log=True)
            return [(ratio, "ratio", value, 0.0)]
        if name == _LATENCY:
            usual = float(row[2])
            late = Parameter(BASE[2], 0.0, 0.5, 0.01, usual, numbers.latency_sd_s)
            return [(late, "change_s", 1.0, -usual)]
        if name == LOAD:
            sizes = (("inertia_ratio", load.inertia_kgm2), ("ratio", load.gravity_Nm))
            return [
                (Parameter(n, -0.9 * x, 9.0 * x, 0.3 * x, 0.0, numbers.load_sd * x), key, x, x)
                for n, (key, x) in zip(LOAD_COLUMNS, sizes, strict=True)
            ]
        effect, free = named(name), []
        for k, p in enumerate(of_effects([effect], row, self.least.inertia_kgm2)):
            absent = k == 0 and not is_limit(effect.parameters[0])
            torque = effect.site in ("load", "friction") and p.name.endswith("torque_Nm")
            most = p.high
            if torque and load is not PER_INERTIA:
                share = 1.0 if effect.load else _FRICTION_SHARE
                most = min(most, share * self.servo.max_torque_Nm)
            low = max(p.low, -most) if p.low < 0 else min(p.low, 0.5 * most)
            middle, sd = 0.0 if absent else p.nominal, DECISION.prior_sd * p.typical
            own = replace(p, low=low, high=most, nominal=middle, prior_sd=sd)
            free.append((own, p.name.partition(".")[2], 1.0, 0.0))
        return free

    def _starts(self, row: Array) -> list[tuple[str, Array]]:
        """Every change beside those of a servo ``row`` (P,), with servos that have it."""
        starts, load, at_rest = list[tuple[str, Array]](), self.least, self.of.way == "rest"

        def add(name: str, values: dict[int, float]) -> None:
            starts.append((name, row.copy()))
            starts[-1][1][list(values)] = list(values.values())

        for name, parameter in _RATIOS.items() if not at_rest else ():
            k = COLUMNS.index(parameter)
            for ratio in _STARTS if row[k] > 0 else ():
                add(name, {k: row[k] * ratio})
        for later in (-0.01, 0.01, 0.03) if not at_rest else ():
            add(_LATENCY, {2: max(row[2] + later, 0.0)})
        for ratio in _STARTS if load.gravity_Nm > 0 else ():
            add(LOAD, {3: (ratio - 1) * load.inertia_kgm2, 4: (ratio - 1) * load.gravity_Nm})
        there = {COLUMNS[k].partition(".")[0] for k in np.flatnonzero(row) if "." in COLUMNS[k]}
        for option in candidates(there - {"motor"}, float(self.of.row[0]), load.inertia_kgm2):
            for start in option.starts if not option.effect.everywhere else ():
                add(option.effect.name, dict(zip(option.columns.tolist(), start, strict=True)))
        return starts

    def screened(
        self, problem: Changes, row: Array, *, present: Set = frozenset(), only: Sequence[str] = ()
    ) -> dict[str, tuple[float, Array]]:
        """By change, the gain in log-likelihood along a straight line, and the servo (P,) there.

        Of those that are not ``present``, or ``only`` of some.
        """
        starts = [
            (name, start)
            for name, start in self._starts(row)
            if name not in present and (not only or name in only)
        ]
        errors = problem.row_residuals(np.array([row, *(start for _, start in starts)]))
        error, moved = errors[0], np.nan_to_num(errors[1:] - errors[:1])
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * max(robust_scale(error), 1e-9))) ** 2)
        square, slope = (moved**2 * weight).sum(axis=1), -(moved * weight) @ error
        either = [name in SET_ANEW or named(name).either_sign for name, _ in starts]
        share = slope / np.maximum(square, 1e-300)
        share = np.clip(share, np.where(either, -1.0, 0.0), 1.0)
        gain = share * slope - 0.5 * share**2 * square
        best: dict[str, tuple[float, Array]] = {}
        for (name, start), one, x in zip(starts, gain, share, strict=True):
            if one > best.get(name, (-1.0, row))[0]:
                best[name] = float(one), row + x * (start - row)
        return best

    def fitted(self, names: Sequence[str], *starts: Array) -> Fitted:
        """Fit changes to the case, from some servos (P,)."""
        own = {name: self._parameters(name) for name in names}
        free = tuple(p for of_change in own.values() for p, *_ in of_change)
        problem = replace(self.case, parameters=free)
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
        sizes: dict[str, dict[str, Estimate]] = {name: {} for name in names}
        for name, of_change in own.items():
            for p, key, unit, more in reversed(of_change):
                low, middle, high = (np.sort(ends[:, problem.names.index(p.name)]) + more) / unit
                sizes[name][key] = Estimate(middle, (high - low) / (2 * Z90), low, high)
        before = self.case.loss(np.zeros((1, 0)), self.case.error[None], 1.0, 1.0)
        gain = 0.5 * float(before[0] - loss[0])
        row = problem.rows(x[:1])[0]
        return Fitted(tuple(names), row, gain, gain - float(occam), left, bare, trust, sizes)


@dataclass(frozen=True)
class Change:
    """What has changed on a joint."""

    # what it is, most probable first, each with those that it is confused with
    groups: tuple[Group, ...]
    probability: Mapping[str, float]  # of each change
    row: Array  # parameters of the case with what is most probable, shape (P,)
    nameless: float = 0.0  # probability that there is something that no change explains
    # where that is, for each recording, if it has an end or a beginning
    windows: Windows | None = None
    link: IrregularTiming | None = None  # irregular timing of the link since, or None
    # parameters of the changes that ``row`` has, by change and name
    sizes: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    left: float = 1.0  # mean square that it leaves, in that of the references

    @property
    def named(self) -> tuple[Group, ...]:
        """The groups that are probable."""
        return tuple(g for g in self.groups if g.probability >= DECISION.named)

    @property
    def effects(self) -> Set:
        """Effects of the catalogue that ``row`` has for what is named."""
        heads = {g.head for g in self.named} - {self.link.effect if self.link else ""}
        load = LOAD_COLUMNS.values() if LOAD in heads else ()
        return frozenset((heads - {*SET_ANEW}).union(load))


def compared(by: Comparison) -> Change:
    """Each change alone, two where the references show that one leaves something, or nothing."""
    row = by.of.row
    looks = by.screened(by.case, row)
    ranked = sorted(looks, key=lambda name: -looks[name][0])
    some = dict.fromkeys([*ranked[:_MOST], *(n for n in ranked if n in SET_ANEW)])
    fits = [by.fitted([name], looks[name][1], row) for name in some]
    best = max(fits, key=lambda fit: fit.evidence)
    # The case counts less, by what the best explanation leaves of it.
    weight, trust = by.case.weight * best.trust**0.5, by.case.trust * best.trust
    by.case = replace(by.case, weight=weight, trust=trust).differing(by.law_sd)
    least = _NEAR * best.evidence if best.evidence > 0 else best.evidence
    fits = [by.fitted(fit.names, fit.row, row) for fit in fits if fit.evidence >= least]
    wrong, left = DECISION.change.law_error**2 * by.start_bare, min(fit.bare for fit in fits)
    if by.of.way == "repeat" and left > max(DECISION.change.misfit_ratio, wrong):
        return _two(by, fits) or _single(by, fits)
    return _single(by, fits)


def _single(by: Comparison, fits: Sequence[Fitted]) -> Change:
    """One change, or none, or one that has no name."""
    numbers, way = DECISION.change, by.of.way
    best = max(fits, key=lambda fit: fit.evidence)
    # The mean gain of a change in unchanged recordings, of which the references are known.
    count = by.case.count * by.case.trust
    usual = numbers.null_rest * count if way == "rest" else numbers.null_repeat
    usual += numbers.null_law * count * by.misfit
    seen = []
    for reference in by.references:
        looks = by.screened(reference, by.of.row, only=best.names)
        seen.append(max(float(looks[name][0]) if name in looks else 0.0 for name in best.names))
    known = numbers.null_known + len(seen)
    null = (numbers.null_known * usual + sum(seen)) / known
    sure = float(expit(student(best.gain * best.trust / null, known) + LOG_PRIOR))
    behind = np.array([best.evidence - fit.evidence for fit in fits]) * best.trust
    share = np.exp(-behind / (1 + numbers.law_error**2 * 2 * best.gain * best.trust))
    # As likely of all parameters together as of all effects.
    share *= [len(FITTED) / len(SET_ANEW) if fit.names[0] in SET_ANEW else 1.0 for fit in fits]
    share *= sure / share.sum()
    probability = {fit.names[0]: float(p) for fit, p in zip(fits, share, strict=True)}
    group = _group(probability)
    (head,) = (fit for fit in fits if fit.names[0] == group.head)
    if way == "rest" or head.left > numbers.misfit_ratio:
        group = replace(group, probability=min(group.probability, numbers.most_certain))
    return Change((group,), probability, head.row, sizes=head.sizes, left=head.left)


def _group(probability: Mapping[str, float]) -> Group:
    """The most probable change and those that are indistinguishable from it."""
    order = sorted(probability, key=lambda n: -probability[n])
    members = [n for n in order if probability[n] >= DECISION.group_share * probability[order[0]]]
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    return Group(tuple(members), sure)


def _two(by: Comparison, fits: Sequence[Fitted]) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    alone = {fit.names[0]: fit for fit in fits}
    found: dict[Set, Fitted] = {}

    def extend(name: str) -> None:
        """Fit the changes that add most to this one."""
        first = alone.get(name) or by.fitted([name], by.of.row)
        looks = by.screened(by.case, first.row, present=frozenset((name,)))
        for other in sorted(looks, key=lambda n: -looks[n][0])[: _MOST // 2]:
            pair = frozenset((name, other))
            if pair not in found:
                found[pair] = by.fitted([name, other], looks[other][1])

    def best() -> Fitted:
        return max(found.values(), key=lambda fit: fit.evidence)

    for fit in sorted(fits, key=lambda fit: fit.bare)[:_HEADS]:
        extend(fit.names[0])
    for name in best().names:  # its rivals, together with the other one
        extend(name)
    two = best()
    least = min(fit.bare for fit in fits)
    if mostly_left(by, two.left) or DECISION.change.misfit_ratio * two.bare > least:
        return None
    probability: dict[str, float] = {}
    groups = []
    for head, other in (two.names, two.names[::-1]):
        rivals = {next(iter(p - {other})): fit for p, fit in found.items() if other in p}
        # As wrong as a law may be of what this one explains together with the other.
        more = max(two.gain - alone[other].gain if other in alone else two.gain, 0.0)
        blur = 1 + DECISION.change.law_error**2 * 2 * more * two.trust
        cost = {n: two.evidence - fit.evidence for n, fit in rivals.items()}
        weight = {n: float(np.exp(-x * two.trust / blur)) for n, x in cost.items()}
        total = sum(weight.values())
        mine = {n: DECISION.most_certain * w / total for n, w in weight.items()}
        groups.append(_group({head: mine.pop(head)} | mine))
        probability |= {n: 0.5 * p for n, p in mine.items() if p > probability.get(n, 0.0)}
        probability[head] = 0.5 * groups[-1].probability
    return Change(tuple(groups), probability, two.row, sizes=two.sizes, left=two.left)


def mostly_left(by: Comparison, left: float) -> bool:
    """Whether most of what a case has beyond its references is left, mean squares in theirs."""
    numbers = DECISION.change
    return left > max((1 - numbers.explained_share) * by.start, numbers.misfit_ratio)
