"""What to record next: the command and the change of context that tell rivals apart."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.result import Diagnosis, Experiment
from sim2real.effects import named
from sim2real.identification.servo_problem import Hypothesis, Servos, minimise, residual_angles
from sim2real.output import beside
from sim2real.recording import Load, Recording, write_recording
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.trace import Trace

_CLEAR = float(-2 * ndtri(DECISION.false_alarms))
"""Distance, in standard deviations of the noise, at which two rivals are seldom confused."""
_WEIGHT = (0.05, 0.1)
"""Mass in kg and arm in m of a weight that anyone can make."""
_CONTEXTS = {
    "none": "as it is",
    "added_inertia": "with twice the inertia on the shaft",
    "added_weight": "with a weight of 50 g on an arm of 0.1 m",
    "lower_supply": "at three quarters of the supply voltage",
}


_Pair = tuple[Hypothesis, Hypothesis]


@dataclass(frozen=True)
class _Plan:
    context: str
    signal: str
    t: Array
    command: Array


def next_experiment(
    trace: Trace,
    rivals: Sequence[Hypothesis],
    members: Sequence[str],
    component: str,
    reach: float,
    *,
    finalists: int = 3,
    contexts: Sequence[str] = tuple(_CONTEXTS),
) -> Experiment | None:
    """The cheapest experiment that tells the members of a group apart.

    All rivals are simulated on every command of a menu in every context; two of them are as far
    apart as the whitened difference of their angles after the first has been refitted to the second
    (T-optimality: Atkinson, Fedorov, Biometrika 62 (1975) 57-70).

    Args:
        trace: A recording of the joint, for its load.
        rivals: One fit a member.
        members: The members.
        component: The joint.
        reach: Largest command to either side, rad.
        finalists: Commands whose refits are continued, after a few steps have ranked all.
        contexts: Contexts that are to be had, names of ``Experiment.context``.
    """
    if len(rivals) < 2:
        return None
    menu = itertools.product(contexts, _signals(reach).items())
    plans = [_Plan(context, name, t, command) for context, (name, (t, command)) in menu]
    plain = np.array([plan.context == "none" for plan in plans])
    pairs = list(itertools.combinations(rivals, 2))
    scores = np.full(len(plans), -1.0)
    for some in filter(len, (np.flatnonzero(plain), np.flatnonzero(~plain))):
        # The other contexts only where no command tells the rivals apart as things are.
        rough = _rough_separations(trace, [plans[k] for k in some], pairs)
        for k in np.argsort(-rough.min(axis=0))[:finalists]:
            nearest_first = np.argsort(rough[:, k])
            scores[some[k]] = _least_separation(
                trace, plans[some[k]], [pairs[n] for n in nearest_first], float(scores.max())
            )
        if scores.max() >= _CLEAR:
            break
    best = int(scores.argmax())
    plan, score = plans[best], float(scores[best])
    return Experiment(
        component=component,
        separates=tuple(members),
        command=plan.signal,
        context=plan.context,
        separation=score,
        duration_s=float(plan.t[-1]),
        statement=_statement(plan, score, members, component),
        t=plan.t,
        signal=plan.command,
    )


def write_commands(found: Diagnosis, out: Path) -> Diagnosis:
    """Write the command of the next experiment as a recording without positions.

    Args:
        found: The diagnosis.
        out: The diagnosis file; the commands are written to its folder.

    Returns:
        The diagnosis, naming the file.
    """
    plan = found.next_experiment
    if plan is None or plan.t is None or plan.signal is None:
        return found
    if plan.component not in found.model.joints:  # a swim
        return found
    path = beside(out, f"{out.stem}.next.csv")
    load = found.model.joints[plan.component].load
    recording = Recording(
        name=path.stem,
        kind="servo",
        joints=(plan.component,),
        t=plan.t,
        command=plan.signal[:, None],
        position=np.full((plan.t.size, 1), np.nan),
        loads={} if load is None else {plan.component: loaded(load, plan.context)},
        source="commands to record next, by sim2real diagnose",
    )
    write_recording(recording, path)
    return replace(found, next_experiment=replace(plan, file=path.name))


def _signals(reach: float, *, period_s: float = 0.02) -> Mapping[str, tuple[Array, Array]]:
    """The menu of commands, each from rest at 0."""
    t = np.asarray(period_s * np.arange(round(16.0 / period_s)))
    ladder = np.minimum(1.0, np.floor(t / 4 + 1) / 4)
    sweep = 2 * np.pi * (0.1 * t + 0.5 * 2.4 / 16 * t**2)
    steps = np.array([0, 0.2, -0.2, 0.5, -0.5, 1.0, -1.0, 0])[(t / 2).astype(int)]
    slow, fast = (1 - np.abs((t / seconds + 0.25) % 1 * 4 - 2) for seconds in (8, 4))
    shapes = {
        "slow small triangles": 0.1 * fast,
        "slow large triangles": slow,
        "steps of growing size": steps,
        "a sweep from 0.1 to 2.5 Hz": np.sin(sweep),
        "small fast sines": 0.15 * np.sin(2 * np.pi * 2 * t),
        "sines of growing size": ladder * np.sin(2 * np.pi * t),
        "long holds": np.array([0, 0.8, 0.8, -0.8])[(t / 4).astype(int)],
    }
    return {name: (t, reach * shape) for name, shape in shapes.items()}


def loaded(load: Load, context: str) -> Load:
    """What the shaft turns in a context, by its name in ``Experiment.context``."""
    if context == "added_inertia":
        return replace(load, inertia_kgm2=2 * load.inertia_kgm2)
    if context == "added_weight":
        mass, arm = _WEIGHT
        moment = load.pendulum_mass_kg * load.pendulum_length_m + mass * arm
        total = load.pendulum_mass_kg + mass
        return Load(load.inertia_kgm2 + mass * arm**2, total, moment / total)
    return load


def _rough_separations(
    trace: Trace, plans: Sequence[_Plan], pairs: Sequence[_Pair], *, iterations: int = 3
) -> Array:
    """Separation of every pair by every plan after a few steps of refits, (pairs, plans)."""
    staged = [_staged(trace, plan) for plan in plans]
    return np.array([_separations(staged, plans, *pair, iterations=iterations) for pair in pairs])


def _least_separation(
    trace: Trace, plan: _Plan, pairs: Sequence[_Pair], enough: float, *, iterations: int = 8
) -> float:
    """Separation of the two rivals that a plan separates least, whichever of them is true.

    One that is not above ``enough`` is returned at once, as another plan is then better.
    """
    least, staged = np.inf, [_staged(trace, plan)]
    for first, second in pairs:
        for pair in ((first, second), (second, first)):
            if least > enough:
                (separation,) = _separations(staged, [plan], *pair, iterations=iterations)
                least = min(least, float(separation))
    return least


def _staged(trace: Trace, plan: _Plan) -> Trace:
    """A plan as if it had been recorded, with all angles 0."""
    everywhere, still = np.ones(plan.t.size, dtype=bool), np.zeros(plan.t.size)
    load = loaded(trace.load, plan.context)
    return Trace("next", "next", plan.t, plan.command, still, load, everywhere)


def _separations(
    staged: Sequence[Trace],
    plans: Sequence[_Plan],
    first: Hypothesis,
    second: Hypothesis,
    *,
    iterations: int,
) -> Array:
    """Distance of two rivals in units of the noise, the first refitted to the second, by plan."""
    true = replace(second.fit, servos=_for_plans(second, plans))
    angles = residual_angles(Batch([[plan] for plan in staged]), true)
    pairs = zip(staged, angles, strict=True)
    batch = Batch([[replace(plan, position=angle[0])] for plan, angle in pairs])
    start = _for_plans(first, plans)
    fits = minimise(batch, start, iterations=iterations, white=True)
    noise = np.zeros((len(plans), batch.lags))
    known = first.fit.autoregression[0][: batch.lags]
    noise[:, : known.size] = known
    problems = Problems(start.joint, fits.servos.theta[:, None], np.zeros((len(plans), 1)))
    left = batch.evaluate(problems, autoregression=noise).square[:, 0]
    variance = float(first.fit.error2[0] / first.fit.count[0])
    return np.asarray(np.sqrt(left / variance))


def _for_plans(rival: Hypothesis, plans: Sequence[_Plan]) -> Servos:
    """One servo a plan, weaker where the supply is lower."""
    many = rival.fit.servos[np.zeros(len(plans), dtype=np.intp)]
    theta = many.theta.copy()
    theta[[plan.context == "lower_supply" for plan in plans], 0] *= 0.75
    return replace(many.of_joints(range(len(plans))), theta=theta)


def _statement(plan: _Plan, score: float, members: Sequence[str], component: str) -> str:
    rivals = " and ".join(named(name).plain for name in members)
    if score < DECISION.report.experiment_min_separation:
        return (
            f"No command or context of the menu tells {rivals} of {component} apart "
            f"({score:.1f} times the noise at best): a second sensor would."
        )
    return (
        f"Record {component} once more, {_CONTEXTS[plan.context]}, on {plan.signal} "
        f"({plan.t[-1]:.0f} s), and diagnose both recordings with --diagnosis: {rivals} would then "
        f"differ by {score:.0f} times the noise."
    )
