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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.inference.calibrate import (
    BLOCK,
    Calibrated,
    Free,
    calibrate,
    effect_parameters,
    law_parameters,
    seen,
    servo_parameters,
)
from sim.inference.swim_findings import findings
from sim.inference.swims import Simulator, Swim
from sim2real.body import BODY, CAMERA, body_effect
from sim2real.diagnose.result import Diagnosis, Estimate, NamedEffect, Rival, Verdict
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

ENOUGH, ENOUGH_BESIDE = 20.0, 12.0
"""Gain in log-likelihood from which an effect is named: of swims alone, and beside references.

``datasets/pool/clean``, in which nothing is missing, brings 16 for friction of its rubber, which is
the twin's fault; two swims of other servos, with nothing missing either, bring 0 and 8 more than a
third of their kind (``benchmarks/pool_development.py``). The choice has seen these.
"""
MOST = 2
"""Effects that are looked for together."""
_QUICK, _SLOW = 6, 12
_Z90 = 1.645
_ALIKE = 1.0
"""Difference in gain below which two effects cannot be told apart."""


@dataclass(frozen=True)
class Tried:
    """An effect with its fit.

    Attributes:
        effect: Its identifier.
        component: The material it belongs to, or ``body`` or ``camera``.
        free: Its parameters.
        gain: Log-likelihood gained over the model without it, less what its parameters gain by
            chance (Schwarz, Ann. Stat. 6 (1978) 461).
        fit: The fit of all.
        rivals: What else was tried when it was kept, best first.
    """

    effect: str
    component: str
    free: tuple[Free, ...]
    gain: float
    fit: Calibrated
    rivals: tuple[Tried, ...] = ()


def candidates(robot: Robot) -> list[tuple[str, str, tuple[Free, ...]]]:
    """Effects, what they belong to, their parameters."""
    out = []
    for effect in (*BODY, *CAMERA):
        if effect.by_material:
            for material in sorted({link.material or "" for link in robot.links}):
                free = tuple(effect_parameters(effect.name, material))
                out.append((effect.name, material or "body", free))
        else:
            where = "camera" if effect.camera else "body"
            out.append((effect.name, where, tuple(effect_parameters(effect.name))))
    return out


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
    known = candidates(robot)
    enough = ENOUGH_BESIDE if references else ENOUGH
    rounds = (MOST + bool(references)) * len(known)
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        progress(min(done / rounds, 0.99))

    def search(given: Sequence[Swim], kept: Sequence[Tried], now: Calibrated) -> list[Tried]:
        """Each effect beside those that are kept, not ranked."""
        found = []
        for effect, component, free in known:
            tell()
            if any(one.effect == effect and one.component == component for one in kept):
                continue
            used = [*base, *(p for one in kept for p in one.free), *free]
            fit = calibrate(given, model, used, simulator, evaluations=_QUICK, view=seen)
            found.append(Tried(effect, component, free, _gain(now, fit, len(free), given), fit))
        return found

    feigned: dict[tuple[str, str], float] = {}
    if references:
        before = calibrate(references, model, base, simulator, evaluations=_SLOW, view=seen)
        ratio = _samples(swims) / _samples(references)
        for one in search(references, (), before):
            feigned[one.effect, one.component] = ratio * max(one.gain, 0.0)
    plain = now = calibrate(swims, model, base, simulator, evaluations=_SLOW, view=seen)
    kept: list[Tried] = []
    ranked: list[Tried] = []
    for _ in range(MOST):
        ranked = [
            replace(one, gain=one.gain - feigned.get((one.effect, one.component), 0.0))
            for one in search(swims, kept, now)
        ]
        ranked.sort(key=lambda one: -one.gain)
        if ranked[0].gain < enough:
            break
        kept.append(replace(ranked[0], rivals=tuple(ranked[1:])))
        now = ranked[0].fit
    progress(1.0)
    return _diagnosis(plain, now, kept, ranked, robot, enough)


def _samples(swims: Sequence[Swim]) -> int:
    return sum(swim.t.size for swim in swims)


def _gain(before: Calibrated, after: Calibrated, parameters: int, swims: Sequence[Swim]) -> float:
    """Independent blocks times the logarithm of the error, fitted and held out."""
    blocks = _samples(swims) / BLOCK
    fitted = float(np.log(before.train[1] / after.train[1]).sum())
    held = float(np.log(before.rmse[1] / after.rmse[1]).sum())
    share = 2 / 3
    chance = 0.5 * parameters * np.log(blocks * before.train.shape[1])
    # An effect must help on both: what is fitted alone, or by luck on the rest, is none.
    both = blocks * (share * fitted + (1 - share) * held)
    return float(min(both, blocks * fitted) - chance)


def _diagnosis(
    plain: Calibrated,
    now: Calibrated,
    kept: list[Tried],
    ranked: list[Tried],
    robot: Robot,
    enough: float,
) -> Diagnosis:
    named = tuple(_named(one, plain, now, enough) for one in kept)
    chosen = {(one.effect, one.component) for one in kept}
    rest = [one for one in ranked if (one.effect, one.component) not in chosen]
    top = np.array([max(one.gain, -50.0) for one in rest])
    share = np.exp(top - enough) / (1 + np.exp(top - enough).sum()) if rest else top
    rivals = [
        Rival(one.effect, one.component, float(p))
        for one, p in zip(rest[:5], share[:5], strict=True)
    ]
    gate = "By the reduced-order twin: its own error (reports/twin) counts as nothing missing."
    train, held = (np.stack([getattr(fit, part)[1] for fit in (plain, now)])
                   for part in ("train", "rmse"))  # fmt: skip
    return findings(
        robot, _verdict(named), named, rivals, train, held, held[1], gate, now.model, plain.model
    )


def _verdict(named: Sequence[NamedEffect]) -> Verdict:
    if not named:
        return "consistent"
    return "ambiguous" if any(len(one.group) > 1 for one in named) else "explained"


def _named(one: Tried, plain: Calibrated, now: Calibrated, enough: float) -> NamedEffect:
    names = [p.name for p in now.free]
    parameters = {}
    said = []
    for p in one.free:
        k = names.index(p.name)
        mean, sd = float(now.best[k]), float(now.sd[k])
        short = p.name.rpartition(".")[2]
        parameters[short] = Estimate(mean, sd, mean - _Z90 * sd, mean + _Z90 * sd)
        said.append(f"{short} {mean:.3g}")
    alike = [other for other in one.rivals if one.gain - other.gain < _ALIKE]
    others = [other.gain - one.gain for other in one.rivals if other not in alike]
    odds = np.array([*others, enough / 2 - one.gain])
    probability = 1 / (1 + float(np.exp(odds).sum()))
    errors = [float(np.hypot(*fit.rmse[1, :2])) for fit in (plain, now)]
    shift = {
        p.name: float(now.best[names.index(p.name)] - plain.best[k])
        for k, p in enumerate(plain.free)
        if p.name in names
    }
    title = body_effect(one.effect).title
    where = f" ({one.component})" if body_effect(one.effect).by_material else ""
    return NamedEffect(
        effect=one.effect,
        component=one.component,
        probability=min(probability, 0.99),
        group=(one.effect, *(other.effect for other in alike)),
        parameters=parameters,
        heldout={"rmse_before": errors[0], "rmse_after": errors[1], "recoverable_removed": None},
        baseline_shift=shift,
        stability=1.0,
        statement=f"{title[0].upper()}{title[1:]}{where}: {', '.join(said)}.",
    )
