"""Which physics of the body or the camera do swims in a pool show that the twin leaves out?

Every effect of the body's and the camera's rows is refitted together with the twin's own law and
the servos' latencies, which would otherwise hide it; the best one is kept and the search goes on.
What counts is the error of all signals, on what was fitted and on what was held out, in units of
what it was before: a gain that chance, or the twin's own faults, could bring names nothing. Beside
the signals stand their means over two seconds. A current, a tether or a turned camera moves these,
and drowns in the beat, where the twin is least right. What the twin gets wrong of every swim of a
robot passes for an effect, too: from references, swims in which nothing is thought to be missing,
the gain is known that an effect brings without being there, and only more than that counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim.inference.calibrate import Calibrated, calibrate
from sim.inference.parameters import candidates, law_parameters, servo_parameters
from sim.inference.problem import BLOCK, seen
from sim.inference.search import MOST, Effect, EffectSearch, Tried
from sim.inference.swim_findings import findings, named_effect, verdict_of
from sim.inference.swims import Simulator, Swim
from sim2real.diagnose.result import Diagnosis, Rival
from sim2real.inference.evidence import chance_gain
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

ENOUGH, ENOUGH_BESIDE = 20.0, 12.0
"""Gain in log-likelihood from which an effect is named: of swims alone, and beside references.

``datasets/pool/clean``, in which nothing is missing, brings 16 for friction of its rubber, which is
the twin's fault; two swims of other servos, with nothing missing either, bring 0 and 8 more than a
third of their kind (``benchmarks/pool_development.py``). The choice has seen these.
"""
_QUICK, _SLOW = 12, 20


def diagnose_swims(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulator: Simulator,
    *,
    references: Sequence[Swim] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find what the body's simulator leaves out.

    Args:
        swims: Pool recordings of one robot in one pool.
        model: The servos.
        robot: The robot.
        simulator: The twin.
        references: Swims of the same robot in which nothing is thought to be missing.
        progress: Called with the share that is done.

    Returns:
        The diagnosis; its errors are those of the speed over ground, in m/s, on what was held out.
    """
    base = [*law_parameters(), *servo_parameters(model, robot)]
    effects = [Effect(*one) for one in candidates(robot)]
    rounds = (MOST + bool(references)) * len(effects)
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        progress(min(done / rounds, 0.99))

    def search(given: Sequence[Swim], shown: Mapping[Effect, float]) -> EffectSearch[Calibrated]:
        """Effects beside the base, less what references show of each, too."""

        def fitted(some: Sequence[Effect]) -> Calibrated:
            used = [*base, *(p for one in some for p in one.free)]
            return calibrate(given, model, used, simulator, evaluations=_QUICK, view=seen)

        def gain(before: Calibrated, after: Calibrated, effect: Effect) -> float:
            return _gain(before, after, len(effect.free), given) - shown.get(effect, 0.0)

        return EffectSearch(effects, fitted, gain, ENOUGH_BESIDE if references else ENOUGH, tell)

    def plainly(given: Sequence[Swim]) -> Calibrated:
        return calibrate(given, model, base, simulator, evaluations=_SLOW, view=seen)

    shown: dict[Effect, float] = {}
    if references:
        ratio = _samples(swims) / _samples(references)
        kept, last = search(references, {}).run(plainly(references), most=1)
        every = [*kept, *(kept[0].rivals if kept else last)]
        shown = {one.effect: ratio * max(one.gain, 0.0) for one in every}
    plain = plainly(swims)
    looked = search(swims, shown)
    kept, last = looked.run(plain, most=MOST)
    progress(1.0)
    return _diagnosis(plain, kept, last, robot, looked.enough)


def _samples(swims: Sequence[Swim]) -> int:
    return sum(swim.t.size for swim in swims)


def _gain(before: Calibrated, after: Calibrated, parameters: int, swims: Sequence[Swim]) -> float:
    """Independent blocks times the logarithm of the error, fitted and held out."""
    blocks = _samples(swims) / BLOCK
    fitted = float(np.log(before.train[1] / after.train[1]).sum())
    held = float(np.log(before.rmse[1] / after.rmse[1]).sum())
    share = 2 / 3
    chance = chance_gain(parameters, blocks * before.train.shape[1])
    # An effect must help on both: what is fitted alone, or by luck on the rest, is none.
    both = blocks * (share * fitted + (1 - share) * held)
    return float(min(both, blocks * fitted) - chance)


def _diagnosis(
    plain: Calibrated,
    kept: Sequence[Tried[Calibrated]],
    last: Sequence[Tried[Calibrated]],
    robot: Robot,
    enough: float,
) -> Diagnosis:
    now = kept[-1].fit if kept else plain
    before, after = (float(np.hypot(*fit.rmse[1, :2])) for fit in (plain, now))
    named = [
        named_effect(one, plain, now, _probability(one, enough), (before, after)) for one in kept
    ]
    top = np.array([max(one.gain, -50.0) for one in last])
    share = np.exp(top - enough) / (1 + np.exp(top - enough).sum()) if last else top
    rivals = [
        Rival(one.effect.name, one.effect.component, float(p))
        for one, p in zip(last[:5], share[:5], strict=True)
    ]
    gate = "By the reduced-order twin: its own error (reports/twin) counts as nothing missing."
    train, held = (np.stack([getattr(fit, part)[1] for fit in (plain, now)])
                   for part in ("train", "rmse"))  # fmt: skip
    verdict = verdict_of(kept)
    return findings(
        robot, verdict, named, rivals, train, held, held[1], gate, now.model, plain.model
    )


def _probability(one: Tried[Calibrated], enough: float) -> float:
    others = [other.gain - one.gain for other in one.rivals if other not in one.alike]
    return 1 / (1 + float(np.exp([*others, enough / 2 - one.gain]).sum()))
