"""Probabilities of effects, and which of them the recordings cannot distinguish."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.screening import FITTED
from sim2real.identification.servo_problem import Hypothesis, Set, Tried


@dataclass(frozen=True)
class Group:
    """One thing that was left out."""

    members: tuple[str, ...]  # the effects that it may be, most probable first
    probability: float  # that one of them is there

    @property
    def head(self) -> str:
        """The most probable of them."""
        return self.members[0]


@dataclass(frozen=True)
class EffectPosterior:
    """Probabilities over the sets that were tried on one joint."""

    sets: tuple[Set, ...]  # the sets, most probable first
    probability: Array  # of each, shape (M,)

    def inclusion(self, *effects: str) -> float:
        """Probability that at least one of these effects is there."""
        has = np.array([not s.isdisjoint(effects) for s in self.sets], dtype=bool)
        return float(self.probability[has].sum())

    def groups(self, base: Set) -> tuple[Group, ...]:
        """The effects of the most probable set, each with those that could stand in for it."""
        best = self.sets[0]
        weight = dict(zip(self.sets, self.probability, strict=True))
        taken = set(best)
        groups = []
        for effect in sorted(best - base, key=lambda e: -self.inclusion(e)):
            swaps = {
                next(iter(s - best)): p
                for s, p in weight.items()
                if len(s) == len(best) and s - best and best - s == {effect}
            }
            rivals = [f for f, p in swaps.items() if p >= DECISION.group_share * weight[best]]
            rivals = [f for f in sorted(rivals, key=lambda f: -swaps[f]) if f not in taken]
            taken.update(rivals)
            members = (effect, *rivals)
            groups.append(Group(members, self.inclusion(*members)))
        return tuple(groups)


def posteriors(found: Sequence[Tried], rng: np.random.Generator) -> list[EffectPosterior]:
    """Probabilities of the sets of each joint of a robot, given what its other joints say.

    That is of the effects of the supply and the link, as log odds.
    """
    separate = [posterior(tried, rng) for tried in found]
    before, shown, together = np.exp(LOG_PRIOR), 1 - DECISION.false_alarms, []
    for j, tried in enumerate(found):
        others, odds = [*separate[:j], *separate[j + 1 :]], {}
        for effect in FITTED if others else ():
            if effect.component != "joint":
                absent = np.prod([1 - shown * p.inclusion(effect.name) for p in others])
                after = absent * before + (1 - absent) * shown / (1 - shown)
                odds[effect.name] = float(np.log(after / before))
        together.append(posterior(tried, rng, odds))
    return together


def posterior(
    found: Tried, rng: np.random.Generator, log_odds: Mapping[str, float] | None = None
) -> EffectPosterior:
    """Probabilities of the sets, averaged over bootstraps of blocks.

    Averaging keeps a model that is best by a little, or in a few segments only, from being called
    certain. Source: Huggins, Miller, Reproducible model selection using bagged posteriors, Bayesian
    Analysis 18 (2023) 79-104. In each bootstrap the parameters are refitted to first order.
    ``log_odds`` adds to the log prior odds of effects.
    """
    tried = sorted(found.tried.values(), key=lambda h: -h.evidence)
    tried = [h for h in tried if h.evidence > tried[0].evidence - 40.0]
    extra = np.array([sum((log_odds or {}).get(e, 0.0) for e in h.members) for h in tried])
    blocks = tried[0].fit.gram.shape[1]
    used = np.flatnonzero(tried[0].fit.gram[0, :, 0, 0] > 0)
    weights = np.zeros((200, blocks))
    weights[:, used] = rng.multinomial(used.size, np.full(used.size, 1 / used.size), len(weights))
    scores = np.stack([h.fit.resampled(weights) for h in tried])
    fixed = np.array([h.evidence - float(h.fit.loglikelihood[0]) for h in tried])
    # A refit to a resampled record gains half a unit a parameter more than one to a new record.
    fixed -= 0.5 * np.array([h.fit.servos.columns.shape[1] for h in tried])
    scores *= trusted_share(tried[0], found.plain)
    total = scores + (fixed + extra)[:, None]
    share = np.exp(total - total.max(axis=0))
    share /= share.sum(axis=0)
    probability = share.mean(axis=1)
    order = np.argsort(-probability)
    return EffectPosterior(tuple(tried[k].members for k in order), probability[order])


def trusted_share(best: Hypothesis, plain: Hypothesis) -> float:
    """Share of a difference in log-likelihood that counts, given that laws are approximations.

    A law that is wrong by ``law_error`` of its own effect loses that squared, of the energy that
    the effect has in the innovations, to one that happens to be shaped right.
    """
    ratio = float(plain.fit.error2[0] / best.fit.error2[0])
    energy = 0.5 * float(best.fit.count[0]) * max(ratio - 1.0, 0.0)
    return 1.0 / (1.0 + DECISION.law_error**2 * energy)
