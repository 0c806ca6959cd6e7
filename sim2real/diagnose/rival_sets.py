"""Sets of effects that recordings leave open, with what is needed to predict another recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim2real.arrays import Array, Integers
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.missing.effect_probabilities import trusted_share
from sim2real.diagnose.missing.investigate import Finding, is_no_finding
from sim2real.identification.servo_problem import Hypothesis
from sim2real.inference.normal import NINE_IN_TEN
from sim2real.recording import PER_INERTIA, Load, read_load
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.structured import Fields

_FROM_LOAD = [BASE.index("inertia_kgm2"), BASE.index("gravity_Nm")]
"""Columns that the load of a recording sets."""


@dataclass(frozen=True)
class RivalSet:
    """One set of effects, fitted to the recordings.

    Attributes:
        effects: The effects, without those that every servo has a little of; sorted.
        probability: Probability of the set among all sets that are listed.
        gain: Log-likelihood above that of the plain servo.
        theta: Its parameters, shape (P,), as ``servo.parameters.COLUMNS``.
        columns: Columns of its free parameters, shape (F,).
        information: Precision of the free parameters, given the recordings and the prior, in the
            inverse of the product of their units, shape (F, F).
    """

    effects: tuple[str, ...]
    probability: float
    gain: float
    theta: Array
    columns: Integers
    information: Array


@dataclass(frozen=True)
class JointRivals:
    """The sets of effects that recordings of one joint leave open.

    Attributes:
        component: The joint.
        load: Load of its first recording.
        period_s: Time between samples.
        noise_rad: Standard deviation of the innovations.
        autoregression: Coefficients that whiten the noise, shape (lags,).
        sets: The sets, most probable first.
    """

    component: str
    load: Load
    period_s: float
    noise_rad: float
    autoregression: Array
    sets: tuple[RivalSet, ...]

    @property
    def entropy(self) -> float:
        """Entropy of the probabilities, in nats."""
        p = np.array([one.probability for one in self.sets])
        return float(-np.sum(p * np.log(np.maximum(p, 1e-300))))

    def content(self) -> dict[str, Any]:
        """The entry of ``rival_sets`` in ``diagnosis.json``."""
        return {
            "component": self.component,
            "load": None if self.load is PER_INERTIA else vars(self.load),
            "noise": {
                "innovation_sd_rad": self.noise_rad,
                "period_s": self.period_s,
                "autoregression": self.autoregression.tolist(),
            },
            "sets": [
                {
                    "effects": list(one.effects),
                    "probability": one.probability,
                    "gain": one.gain,
                    "parameters": {
                        COLUMNS[k]: float(one.theta[k])
                        for k in np.flatnonzero(one.theta).tolist()
                        if k not in _FROM_LOAD
                    },
                    "free": [COLUMNS[k] for k in one.columns],
                    "information": one.information.tolist(),
                }
                for one in self.sets
            ],
        }


def read_rival_sets(top: Fields) -> tuple[JointRivals, ...]:
    """The entries of ``rival_sets`` in ``diagnosis.json``.

    Args:
        top: The content of the file.

    Raises:
        InputError: If a field is missing or of another form.
    """
    return tuple(_joint(entry) for entry in top.tables("rival_sets"))


def _joint(entry: Fields) -> JointRivals:
    noise = entry.table("noise")
    load = PER_INERTIA
    if entry.content.get("load") is not None:
        load = read_load(entry.table("load"))
    return JointRivals(
        component=entry.text("component"),
        load=load,
        period_s=noise.number("period_s"),
        noise_rad=noise.number("innovation_sd_rad"),
        autoregression=_numbers(noise, "autoregression"),
        sets=tuple(_set(one) for one in entry.tables("sets")),
    )


def _set(entry: Fields) -> RivalSet:
    parameters = entry.table("parameters")
    free = entry.content.get("free")
    known = (*parameters.content, *(free if isinstance(free, list) else ()))
    if unknown := [name for name in known if name not in COLUMNS]:
        raise entry.error("parameters", f"parameters of a servo, not {unknown[0]!r}")
    theta = np.zeros(len(COLUMNS))
    for name in parameters.content:
        theta[COLUMNS.index(name)] = parameters.number(name)
    columns = np.array([COLUMNS.index(name) for name in free or ()], dtype=np.int32)
    information = _numbers(entry, "information")
    if information.shape != (columns.size, columns.size):
        raise entry.error("information", f"{columns.size} rows of {columns.size} numbers")
    effects = entry.content.get("effects")
    if not isinstance(effects, list):
        raise entry.error("effects", "a list of names of effects")
    return RivalSet(
        effects=tuple(str(name) for name in effects),
        probability=entry.number("probability"),
        gain=entry.number("gain"),
        theta=theta,
        columns=columns,
        information=information,
    )


def _numbers(entry: Fields, name: str) -> Array:
    try:
        values = np.array(entry.content.get(name), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not np.isfinite(values).all():
        raise entry.error(name, "finite numbers")
    return values


def rival_sets(
    joint: JointCase, finding: Finding, *, most: int = 8, hidden: int = 6, uniform: float = 0.3
) -> JointRivals:
    """The sets of effects that may be present in a joint, given its recordings.

    Three kinds of sets: the most probable ones; for every further effect that was considered, the
    most probable set that has it; and the most probable set together with one more effect of the
    largest size that the recordings would not have shown.

    Args:
        joint: The joint.
        finding: What was found on it.
        most: Largest number of sets of the first two kinds.
        hidden: Largest number of the third.
        uniform: Share of the probability that is distributed evenly among all sets: the laws of the
            effects are approximations, so that no probability of a set is certain.
    """
    best, plain = finding.best, finding.tried.plain
    likely = list(_representatives(joint, finding, most))
    sets = [_fitted(effects, p, h, plain) for effects, p, h in likely]
    sets += _hidden(joint, finding, {one.effects for one in sets}, hidden)
    total = sum(one.probability for one in sets)
    sets = [
        replace(one, probability=(1 - uniform) * one.probability / total + uniform / len(sets))
        for one in sets
    ]
    return JointRivals(
        component=joint.name,
        load=joint.traces[0].load,
        period_s=finding.search.batch.period,
        noise_rad=_innovation(best),
        autoregression=best.fit.autoregression[0],
        sets=tuple(sorted(sets, key=lambda one: -one.probability)),
    )


def _innovation(hypothesis: Hypothesis) -> float:
    """Standard deviation of the innovations of a fit, rad."""
    return float(np.sqrt(hypothesis.fit.error2[0] / hypothesis.fit.count[0]))


def _representatives(
    joint: JointCase, finding: Finding, most: int, *, behind: float = 15.0
) -> Iterator[tuple[tuple[str, ...], float, Hypothesis]]:
    """Names, probability and the likeliest fit of the sets; sets of the same names are one.

    Sets whose evidence is more than ``behind`` below the best are listed only if probable.
    """
    tried, weight = finding.tried.tried, dict[tuple[str, ...], float]()
    trust = trusted_share(finding.best, finding.tried.plain)
    chosen: dict[tuple[str, ...], Hypothesis] = {}
    for members, p in zip(finding.posterior.sets, finding.posterior.probability, strict=True):
        names = _names(joint, finding, tried[members])
        weight[names] = weight.get(names, 0.0) + float(p)
        chosen.setdefault(names, tried[members])
    ranked = sorted(weight, key=lambda names: -weight[names])
    first = [names for names in ranked if weight[names] > DECISION.report.rival_min_probability]
    first = first[:most] or ranked[:1]
    covered = {effect for names in first for effect in names}
    for hypothesis in sorted(tried.values(), key=lambda h: -h.evidence):
        names = _names(joint, finding, hypothesis)
        if trust * (finding.best.evidence - hypothesis.evidence) > behind:
            break
        if len(first) < most and names not in first and not covered.issuperset(names):
            first.append(names)
            covered.update(names)
            chosen.setdefault(names, hypothesis)
    for names in first:
        yield names, weight.get(names, 0.0), chosen[names]


def _names(joint: JointCase, finding: Finding, hypothesis: Hypothesis) -> tuple[str, ...]:
    """Effects of a set that a verdict would state."""
    added = hypothesis.members - finding.tried.base
    return tuple(sorted(e for e in added if not is_no_finding(hypothesis, e, joint)))


def _fitted(
    effects: tuple[str, ...], probability: float, hypothesis: Hypothesis, plain: Hypothesis
) -> RivalSet:
    fit, servos = hypothesis.fit, hypothesis.fit.servos
    unit = servos.unit[0]
    normal = fit.gram[0].sum(axis=0)[1:, 1:] * float(fit.count[0] / fit.error2[0])
    information = normal + np.eye(unit.size) / DECISION.prior_sd**2
    return RivalSet(
        effects=effects,
        probability=probability,
        gain=float(fit.loglikelihood[0] - plain.fit.loglikelihood[0]),
        theta=servos.theta[0],
        columns=servos.columns[0].astype(np.int32),
        information=np.asarray(information / np.outer(unit, unit)),
    )


def _hidden(
    joint: JointCase, finding: Finding, taken: set[tuple[str, ...]], most: int
) -> list[RivalSet]:
    """The likeliest set with one more effect, of the largest size that would not have been seen.

    The size is one of those that the search has looked at. Its standard deviation is the size.
    """
    best = finding.best
    share = dict(zip(finding.posterior.sets, finding.posterior.probability, strict=True))[
        best.members
    ]
    known = _fitted(_names(joint, finding, best), share, best, finding.tried.plain)
    seen, options = finding.search.seen(finding.tried, best.members)
    needed = float(np.sqrt(2 * DECISION.detection_gain)) + NINE_IN_TEN
    found: list[RivalSet] = []
    for k, option in enumerate(options):
        names = tuple(sorted({*known.effects, option.effect.name}))
        mine = np.flatnonzero((seen.candidate == k) & (seen.visible < needed))
        if names in taken or option.effect.everywhere or not mine.size:
            continue
        start = int(mine[seen.visible[mine].argmax()])
        theta = known.theta.copy()
        theta[option.columns] = option.starts[seen.start[start]]
        spread = np.maximum(np.abs(theta[option.columns]), 1e-3 * option.unit)
        size, added = known.columns.size, option.columns.size
        information = np.zeros((size + added, size + added))
        information[:size, :size] = known.information
        information[range(size, size + added), range(size, size + added)] = spread**-2.0
        columns = np.concatenate([known.columns, option.columns]).astype(np.int32)
        # Evidence of the effect at the size that fits best, as far as these recordings show it.
        gain = float(seen.gain[seen.candidate == k].max())
        odds = float(np.exp(min(gain + LOG_PRIOR, 0.0)))
        found.append(RivalSet(names, share * odds, known.gain, theta, columns, information))
    return sorted(found, key=lambda one: -one.probability)[:most]
