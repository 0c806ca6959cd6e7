"""What has changed, given how recordings of an unchanged servo differ among themselves.

Every servo lacks some physics, and what it lacks looks different in each recording: an effect that
is freed in one reference alone gains something there, though nothing has changed. What it gains in
each of the references is the scale by which its gain in the case is judged (the dispersion of
quasi-likelihood: McCullagh, Nelder, Generalized Linear Models, 2nd ed., Chapman & Hall, 1989, ch.
9). There are few references, so each effect borrows from the others, and its score has Student's
tails.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.per_recording import Linear, fit_own, fitted, gains, linearised
from sim2real.diagnose.posterior import Group, Posterior
from sim2real.effects import CATALOGUE, named
from sim2real.effects.effect import is_limit
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.problem import Servos, Set
from sim2real.servo.screen import candidate
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_BEHIND, _MOST = 6.0, 8
"""How far behind the first, and how many, are fitted for good."""
_FREE = ("columns", "unit", "low", "high")


@dataclass(frozen=True)
class Contrast:
    """What a change of each effect would explain of a joint's case.

    Attributes:
        effects: The effects, and parameters of the plain servo, of which there are N.
        column: Direction that shows each best, shape (N,).
        size: Change in multiples of that direction, shape (N,).
        gain: Gain in log-likelihood when it is freed in the case alone, shape (N,).
        before: The same for each reference, shape (N, references).
        spread2: Twice the gain of each in an unchanged recording, at least that of noise, (N,).
        left: Energy of the case's innovations that it leaves, in variances of the loudest
            reference's, shape (N,).
        energy: The same with no change.
        count: Samples of the case.
        repeated: Whether the case repeats what its references do.
        theta: Parameters of the case with each change, shape (N, P), once they are fitted.
    """

    effects: tuple[str, ...]
    column: NDArray[np.intp]
    size: Array
    gain: Array
    before: Array
    spread2: Array
    left: Array
    energy: float
    count: float
    repeated: bool
    theta: Array | None = None

    @property
    def known(self) -> float:
        """Recordings that are known to be unchanged, borrowed ones included."""
        return DECISION.change_borrowed + float(self.before.shape[1])

    @property
    def common(self) -> float:
        """Twice the gain of any effect in an unchanged recording, at least that of noise."""
        return max(float(np.mean(2 * self.before)), 1.0)

    @property
    def evidence(self) -> Array:
        """Log odds of each change against none, without the prior, shape (N,)."""
        return _evidence(2 * self.gain / self.spread2, self.size, self.known)

    @property
    def misfit(self) -> Array:
        """What each leaves beyond what the best leaves, shape (N,).

        In nats, tempered by what references leave and by the error of the change's law.
        """
        best = float(self.left.min())
        whole = 0.5 * self.count * (self.energy - best) / self.spread2
        more = 0.5 * self.count * (self.left - best) / self.spread2
        return np.asarray(more / (1 + DECISION.change_law_error**2 * np.maximum(whole, 0.0)))

    @property
    def explained(self) -> Array:
        """Share that each takes of what the case has beyond its references, shape (N,)."""
        beyond = self.energy - 1
        if beyond <= 0:
            return np.full(len(self.effects), np.inf)
        return (self.energy - self.left) / beyond


@dataclass(frozen=True)
class Change:
    """What has changed on a joint.

    Attributes:
        group: The likeliest effect and those that it can't be told from. Nothing is resampled: its
            stability repeats its probability.
        probability: Of each effect, and of each parameter of the plain servo.
        theta: Parameters of the case with the likeliest effect, shape (P,), where it was fitted.
    """

    group: Group
    probability: Mapping[str, float]
    theta: Array | None = None

    def posterior(self, base: Set) -> Posterior:
        """The probabilities as those of sets of effects, nothing more than ``base`` among them."""
        effects = {n: p for n, p in self.probability.items() if n not in (*BASE, *base)}
        order = sorted(effects, key=lambda n: -effects[n])
        sets = (base, *(base | {n} for n in order))
        probability = np.array([1 - sum(effects.values()), *(effects[n] for n in order)])
        return Posterior(sets, probability, probability)


def change(found: Contrast) -> Change:
    """Probabilities of what has changed: each effect alone, or nothing."""
    best = int(np.argmax(found.evidence - found.misfit))
    odds = LOG_PRIOR + (0.0 if found.repeated else DECISION.change_other_motion)
    changed = float(expit(found.evidence[best] + odds))
    lonely = found.explained[best] < DECISION.explained
    strange = DECISION.nameless if lonely else 0.0
    weight = np.exp(np.minimum(found.evidence - found.evidence[best], 0.0) - found.misfit)
    weight *= [np.exp(DECISION.change_retuned) if n in BASE else 1.0 for n in found.effects]
    share = changed * (1 - strange) * weight / weight.sum()
    probability = {n: float(p) for n, p in zip(found.effects, share, strict=True)}
    order = sorted((n for n in found.effects if n not in BASE), key=lambda n: -probability[n])
    members = tuple(
        n for n in order if probability[n] >= DECISION.group_share * probability[order[0]]
    )
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    theta = None if found.theta is None else found.theta[found.effects.index(members[0])]
    return Change(Group(members, sure, sure), probability, theta)


def contrast(linear: Linear) -> Contrast:
    """Weigh a change of each effect against none, to first order."""
    R = linear.gram.shape[0]
    names = tuple(
        n for n in dict.fromkeys(linear.directions) if n in BASE or not named(n).everywhere
    )
    place = [np.flatnonzero([d == n for d in linear.directions]) for n in names]
    alone = [gains(linear, [r])[0] for r in range(linear.references)]
    gain, size, left = gains(linear, range(linear.references, R))
    before = np.array([[one[mine].max() for one in alone] for mine in place])
    column = np.array([mine[np.argmax(gain[mine])] for mine in place])
    loudest = float((linear.gram[:, 0, 0] / linear.count)[: linear.references].max())
    own, count = (
        linear.gram[linear.references :, 0, 0],
        float(linear.count[linear.references :].sum()),
    )
    unit = loudest * count
    known = DECISION.change_borrowed + linear.references
    common = DECISION.change_borrowed * float(np.mean(2 * before))
    spread2 = np.maximum((common + 2 * before.sum(axis=1)) / known, 1.0)
    whole = Contrast(
        names,
        column,
        size[column],
        gain[column],
        before,
        spread2,
        left[column] / unit,
        float(own.sum()) / unit,
        count,
        linear.repeated,
    )
    # Of several starts that which needs the least extrapolation to gain as much.
    score2 = [2 * gain[m] / s for m, s in zip(place, spread2, strict=True)]
    odds = [_evidence(t2, size[m], known) for t2, m in zip(score2, place, strict=True)]
    best = np.array([m[np.argmax(o)] for m, o in zip(place, odds, strict=True)])
    return replace(whole, column=best, size=size[best], gain=gain[best], left=left[best] / unit)


def _evidence(score2: Array, size: Array, known: float) -> Array:
    """Log odds of a change of unknown size, its score following Student's law where there is none.

    The integral over the size is Laplace's; a start that has to be extrapolated far is discounted.
    """
    far = np.maximum(np.abs(size) / DECISION.change_farthest, 1.0) ** 2
    nothing, rest = np.log1p(score2 / known), np.log1p(score2 * (1 - 1 / far) / known)
    return np.asarray(0.5 * (known + 1) * (nothing - rest) - 0.5 * np.log1p(score2))


def refined(found: Contrast, linear: Linear, device: str = "cpu") -> Contrast:
    """The contrast with its likeliest changes fitted, references and case together.

    Args:
        found: What it is to first order.
        linear: What it is of.
        device: Warp device.

    Returns:
        It of these changes alone, where any is worth fitting.
    """
    evidence = found.evidence
    if evidence.max() < DECISION.change_worth:
        return found
    order = _likeliest(found.effects, evidence)
    nothing = replace(linear.servos, **{n: getattr(linear.servos, n)[:, :0] for n in _FREE})
    owns, label = [nothing], [-1]
    for k in order:
        for own in _starts(found, int(k), linear):
            owns.append(own)
            label.append(int(k))
    parts = linear.traces[: linear.references], linear.traces[linear.references :]
    likelihood, left, theta = fit_own(Batch(parts, device), linear, owns)
    gain = likelihood - likelihood[0]
    best = [max(np.flatnonzero(np.array(label) == k), key=lambda h: gain[h]) for k in order]
    loudest = found.energy / float(linear.gram[linear.references :, 0, 0].sum())
    return replace(
        found,
        effects=tuple(found.effects[k] for k in order),
        column=found.column[order],
        size=np.ones(order.size),
        gain=np.maximum(gain[best], 0.0),
        before=found.before[order],
        spread2=found.spread2[order],
        left=left[best] * loudest,
        theta=theta[best],
    )


def _likeliest(effects: Sequence[str], evidence: Array) -> NDArray[np.intp]:
    """Places of those that are fitted: at least one effect, whatever the plain servo explains."""
    order = np.argsort(-evidence)
    first = next(k for k in order if effects[k] not in BASE)
    near = [k for k in order[:_MOST] if evidence[k] > evidence.max() - _BEHIND and k != first]
    return np.array([first, *near])


def _starts(found: Contrast, k: int, linear: Linear) -> list[Servos]:
    """Where the fit of a change begins: as it was looked at, and as large as it seemed to be."""
    name, column, size = found.effects[k], int(found.column[k]), float(found.size[k])
    servos = linear.servos
    if column < linear.shared:
        here = slice(column, column + 1)
        columns, unit = servos.columns[:, here], servos.unit[:, here]
        low, high = servos.low[:, here], servos.high[:, here]
        values = [servos.theta[0, columns[0]] + size * unit[0]]
    else:
        load = linear.traces[0].load.inertia_kgm2
        option = candidate(named(name), float(servos.theta[0, 0]), load)
        columns, unit = option.columns[None], option.unit[None]
        low, high = option.low[None], option.high[None]
        values = [linear.rows[column, option.columns]]
        if not is_limit(option.effect.parameters[0]):
            values.append(values[0].copy())
            values[1][0] = size * values[0][0]
    starts = []
    for value in values:
        theta = servos.theta.copy()
        theta[0, columns[0]] = np.clip(value, low[0], high[0])
        starts.append(Servos(servos.joint, theta, columns, unit, low, high))
    return starts


@dataclass(frozen=True)
class Misstated:
    """What speaks for the load of the references, where another is stated.

    Attributes:
        effects: The effects that stand for the difference.
        gain: Gain in log-likelihood with the references' load.
        theta: Parameters of the servo under the stated load, with the difference, shape (P,).
    """

    effects: tuple[str, ...]
    gain: float
    theta: Array


def misstated(
    references: Sequence[Trace],
    case: Sequence[Trace],
    servos: Sequence[Servos],
    device: str = "cpu",
) -> Misstated | None:
    """Whether a servo that explains the references explains the case better with their load.

    Nothing is free in this: both loads are stated, and one servo is fitted to all recordings with
    the one or the other. So it tells more than the search for a load of any size.

    Args:
        references: The joint's references.
        case: Its recordings in question.
        servos: Where the servo starts from.
        device: Warp device.

    Returns:
        What speaks for the references' load; None where the loads do not differ.
    """
    known, stated = references[0].load, case[0].load
    if any(t.load != known for t in references) or any(t.load != stated for t in case):
        return None
    differs = {
        f"{effect.name}.{effect.parameters[0].name}": difference
        for effect in CATALOGUE
        if effect.load
        and (difference := getattr(known, effect.load) - getattr(stated, effect.load)) != 0
    }
    if not differs:
        return None
    restated = [replace(t, load=known) for t in case]
    _, as_before = fitted([*references, *restated], servos, device)
    _, as_stated = fitted([*references, *case], servos, device)
    theta = as_before.servos.theta[0].copy()
    for column, value in differs.items():
        theta[COLUMNS.index(column)] += value
    gain = float(as_before.loglikelihood[0] - as_stated.loglikelihood[0])
    return Misstated(tuple(column.partition(".")[0] for column in differs), gain, theta)


def what_changed(
    before: Sequence[Trace], case: Sequence[Trace], servos: Sequence[Servos], device: str = "cpu"
) -> tuple[tuple[Group, ...], Change, Array | None]:
    """What of a joint differs from its references.

    Args:
        before: The joint's references.
        case: Its recordings in question.
        servos: Where the servo that they share starts from.
        device: Warp device.

    Returns:
        What is likeliest, at least one group; the weighing of all effects; and the parameters of
        the case with what is likeliest, shape (P,), where that was fitted.
    """
    linear = linearised(before, case, servos, device)
    first = contrast(linear)
    found = change(refined(first, linear, device))
    load = misstated(before, case, servos, device)
    wrong = min(float(expit(load.gain / first.common)), DECISION.most_certain) if load else 0.0
    if load and wrong >= DECISION.named:  # a change seen through a wrong load is none
        return tuple(Group((effect,), wrong, wrong) for effect in load.effects), found, load.theta
    return (found.group,), found, found.theta
