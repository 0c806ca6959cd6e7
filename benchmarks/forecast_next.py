"""What to do next: does the measurement that a forecast ranks first narrow it more than another?

    python -m benchmarks.forecast_next OUT.json --realities 50 --processes 8    # half a minute each

In the twin. Each reality has one effect of the body that the forecast gives a probability of one
half, and what is known of servos, latency, densities, water and the twin's error is drawn, from
well to badly. The reality is one draw of the forecast, so that this judges the ranking and not the
interval (``forecast_realities.py`` does). Each measurement is made: its parameters become the true
values with a tenth of their uncertainty in all draws, in which the policy then swims anew; three
trials are swum in the reality. What counts is the width of the intervals of mean time and energy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks.forecast_realities import AGENTS, POOL, task_of
from benchmarks.harness import command_line, spread
from rl.experiments.statistics import interval
from rl.experiments.testbeds import SimulationSettings
from rl.forecast.causes import group_of, ranked
from rl.forecast.diagnosed import Diagnosed, Possible
from rl.forecast.make import named_controllers
from rl.forecast.realities import DEVIATIONS, Realities, draw_realities
from rl.forecast.swims import Forecaster
from rl.forecast.trials import OBSERVED, Trials, update
from rl.randomize import numbers_of, with_density
from sim.inference.swims import with_values
from sim2real.arrays import Array
from sim2real.effects import BODY, find
from sim2real.model import Model, read_model
from sim2real.output import write_json
from sim2real.posterior.posteriors import JointSample
from sim2real.ranges.entry import Ranges, normal, uniform
from sim2real.robot import Robot, read_robot

EFFECTS = (
    "added_mass", "form_drag", "linear_drag", "skin_damping", "skin_elasticity",
    "surface_friction.rubber",
)  # fmt: skip
JUDGED = ("time_s", "energy")


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number that is log-uniform from low to high."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def known_of(robot: Robot, rng: np.random.Generator, n: int) -> tuple[Realities, Model, Array]:
    """N draws of what the robot may be, and what it is: a model and the errors of the law."""
    model = with_density(read_model(POOL / "forecast" / "model.json"), robot)
    gains = tuple(f"{j}.{g}" for j in model.joints for g in ("kp_Nm_per_rad", "kd_Nms_per_rad"))
    numbers = numbers_of(model)
    value = np.array([numbers[name] for name in gains])
    sd = np.repeat([between(rng, 0.005, 0.15) for _ in model.joints], 2)
    sample = JointSample(
        gains, ("",) * len(gains), value * np.exp(sd * rng.standard_normal((2000, len(gains))))
    )
    entries = [uniform(name, 0, 1, "", "") for name in gains]
    late, spread = numbers["j1.latency_s"], between(rng, 0.001, 0.02)
    entries.append(uniform("command_latency_s", late - spread, late + spread, "s", ""))
    heavy, links = between(rng, 0.002, 0.05), [link.name for link in robot.links]
    for link, density in zip(links, model.body["normalised_density"], strict=True):
        entries.append(normal(f"body.normalised_density.{link}", density, heavy, "", ""))
    posterior = model.body["posterior"]
    wide = np.array(posterior["covariance"]) * between(rng, 1.0, 100.0)
    posterior = {**posterior, "covariance": wide.tolist()}
    model = replace(model, body={**model.body, "posterior": posterior})
    name = EFFECTS[rng.integers(len(EFFECTS))]
    effect, _, material = name.partition(".")
    parameters = find(BODY, effect, "effects").parameters
    size = {p.name: p.typical * between(rng, 0.5, 3.0) for p in parameters}
    maybe = Possible(effect, material, 0.5, size, {k: x / 2 for k, x in size.items()})
    drawn = draw_realities(
        robot, model, Ranges(tuple(entries)), sample, n + 1, rng,
        diagnosed=Diagnosed((), (maybe,), {}),
    )  # fmt: skip
    truth = with_values(drawn.models[n], {f"{name}.{k}": x for k, x in maybe.drawn(rng).items()})
    rest = replace(drawn, models=drawn.models[:n], values=drawn.values[:n], law=drawn.law[:n])
    return rest, truth, drawn.law[n]


def measured(
    drawn: Realities, truth: Model, law: Array, names: Sequence[str], rng: np.random.Generator
) -> Realities:
    """The draws after the parameters of these names were measured, to a tenth of their spread."""
    true = {**numbers_of(truth), **dict(zip(DEVIATIONS, law, strict=True))}
    n, values = len(drawn.models), drawn.values.copy()
    for name in names:
        k, noise = drawn.names.index(name), rng.standard_normal() + rng.standard_normal(n)
        values[:, k] = true.get(name, 0.0) + 0.1 * drawn.values[:, k].std() * noise
        if name not in DEVIATIONS:
            values[:, k] = np.maximum(values[:, k], 0.0)
    rows = [dict(zip(drawn.names, map(float, row), strict=True)) for row in values]
    models = [_changed(m, row, names) for m, row in zip(drawn.models, rows, strict=True)]
    fresh = [[row.get(name, 0.0) for name in DEVIATIONS] for row in rows]
    return replace(drawn, models=tuple(models), values=values, law=np.array(fresh))


def _changed(model: Model, row: Mapping[str, float], names: Sequence[str]) -> Model:
    weight = "body.normalised_density."
    density = list(model.body["normalised_density"])
    for name in names:
        if name.startswith(weight):
            density[int(name.removeprefix(weight))] = row[name]
    model = replace(model, body={**model.body, "normalised_density": density})
    others = [n for n in names if not n.startswith(weight) and n not in DEVIATIONS]
    return with_values(model, {n.removeprefix("body."): row[n] for n in others})


def one_reality(seed: int, draws: int, seconds: float) -> dict[str, Any]:
    """Expected and found narrowing by each measurement, the one ranked first first."""
    import torch

    torch.set_num_threads(1)
    rng, robot = np.random.default_rng(seed), read_robot(POOL / "robot.toml")
    drawn, truth, law = known_of(robot, rng, draws)
    joints = [joint.name for joint in robot.joints]
    controllers = named_controllers([str(AGENTS / "all-0" / "policy.npz")], robot)
    settings = SimulationSettings(at_once=draws)

    def swum(realities: Realities, trials: int) -> dict[str, Array]:
        trial = Forecaster(robot, task_of(seconds), realities, trials, seed, settings)
        return {name: x[0] for name, x in trial.swim(controllers).items()}

    def width(figures: Mapping[str, Array], weights: Array) -> Array:
        return np.array([np.ptp(interval(figures[name], weights)[1:]) for name in JUDGED])

    even, before = np.full(draws, 1 / draws), swum(drawn, 2)
    figures = {name: before[name] for name in ("success", *JUDGED)}
    ranking = ranked(drawn.names, drawn.values, figures, even, joints)
    expected = {x.what: float(np.mean([x.shrinks.get(n, 0.0) for n in JUDGED])) for x in ranking}
    narrowed = {}
    for what in expected:
        group = [name for name in drawn.names if group_of(name, joints)[0] == what]
        if group:
            after = width(swum(measured(drawn, truth, law, group, rng), 2), even)
        else:  # trials
            alone = replace(drawn, models=(truth,), law=law[None])
            seen = swum(alone, 3)
            observed = np.stack([seen[name][0] for name in OBSERVED], axis=1)
            known = update(
                [Trials(0, OBSERVED, observed)], {name: x[None] for name, x in before.items()}
            )
            after = width(before, known.weights)
        share = after / np.maximum(width(before, even), 1e-9)
        narrowed[what] = float(np.mean(1 - share))
    effects = [e["effect"] for e in truth.body["effects"]]
    return {"seed": seed, "effect": effects, "expected": expected, "narrowed": narrowed}


def summary(results: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """How the first compares with a random other measurement, with trials and without."""
    out = {"realities": float(len(results))}
    for kind, left in (("all", ()), ("without trials", ("3 trials",))):
        wins, gains, losses, rank = [], [], [], []
        for one in results:
            found = {k: x for k, x in one["narrowed"].items() if k not in left}
            first, *others = found.values()
            wins.append(np.mean(first > np.array(others)))
            gains.append(first)
            losses.append(np.mean(others))
            said = [one["expected"][what] for what in found]
            rank.append(spearmanr(said, list(found.values())).statistic)
        out |= {
            f"{kind}: first is better": float(np.mean(wins)),
            f"{kind}: narrowing by the first": float(np.median(gains)),
            f"{kind}: by another": float(np.median(losses)),
            f"{kind}: rank correlation": float(np.nanmedian(rank)),
        }
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge the ranking in some realities."""
    seconds = (10.0, "longest trial")
    options = command_line(
        __doc__, "out", realities=50, seed=42, draws=100, seconds=seconds, processes=1
    ).parse_args(arguments)
    work = partial(one_reality, draws=options.draws, seconds=options.seconds)
    seeds = range(options.seed, options.seed + options.realities)
    results = []
    for done in spread(work, seeds, options.processes, unit="reality"):
        results.append(done)
        print(done["seed"], done["effect"], done["narrowed"], flush=True)
    found = summary(results)
    write_json(options.out, {"summary": found, "realities": results})
    for name, value in found.items():
        print(f"{name:<40} {value:8.3g}")


if __name__ == "__main__":
    main()
