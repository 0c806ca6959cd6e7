"""Searches on one joint, as a diagnosis makes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from simulated import NOISE, traced

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.effect_search import first_look, search
from sim2real.diagnose.servo_search import ServoSearch, baselines, plain_sets
from sim2real.identification.servo_problem import Fits, Tried
from sim2real.servo.batch import Batch
from sim2real.servo.trace import Trace


@dataclass(frozen=True)
class Searched:
    traces: Sequence[Trace]
    batch: Batch
    plain: Fits
    tried: Tried
    search: ServoSearch

    @property
    def seen(self):
        """The screen of the plain servo, and its candidates."""
        return self.search.seen(self.tried, frozenset())


def searched(noise=NOISE, traces=(), **effects) -> Searched:
    """The search on two recordings, by default of a servo with these effects."""
    given = {"seconds": 8.0, **effects}
    traces = list(traces) or [traced(1, "a", **given), traced(2, "b", **given)]
    joints, rng = [JointCase("j1", traces, noise, None)], np.random.default_rng(0)
    batch = Batch([traces])
    plain = baselines(batch)
    first = plain_sets(plain)
    first_look(ServoSearch(batch, joints, 0.01, rng), first)
    (tried,), problem = search(batch, joints, first, level=0.01, rng=rng)
    return Searched(traces, batch, plain, tried, problem)
