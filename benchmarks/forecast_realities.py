"""Forecasts of policies in concealed realities: do the intervals hold, and is the ranking right?

    python -m benchmarks.forecast_realities swim OUT --device cuda:0     # minutes on a GPU
    python -m benchmarks.forecast_realities forecast OUT --processes 32  # some minutes
    python -m benchmarks.forecast_realities score OUT
    python -m benchmarks.forecast_realities energy OUT    # of several waters: --groups 8

Realities are those of ``datasets/pool``: fluid in cells of its own with another viscosity and wall,
servos, skins and faults written apart from the library's laws. Of each, a swim of twelve seconds
and bench values that are off by up to 5 % are known (``inputs``); the trials of the policies are in
``answers``, whose hashes are printed before anything is forecast, and which only ``score`` reads.
With ``swim --twin`` (minutes on a CPU) realities are twins with laws of their own, errors of the
twin as large as a forecast takes them to be, and the library's effects: the intervals then show
whether diagnosis, calibration and draws are as certain as they say, not whether the twin is right.
Each reality is diagnosed and calibrated in the twin, and forecast twice: from all that is
known, and from hand-set ranges (Lin, Liu, Wang 2024, Table II: latency and noise). All stages
resume; after a change of the forecast only ``forecasts/*.npz`` are to be removed.

``energy`` writes ``rl/forecast/twin_error.json``: how real energy differs from that forecast,
policy by policy: the median of the logarithm of their ratio, and half the distance of its 16 % and
84 % quantile, so that the few robots whose joints oscillate do not decide, less the spread that the
other parameters of a draw explain. Each water is left out in turn, to show their spread.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from benchmarks.harness import ROOT, command_line, spread
from rl.experiments.episodes import FIGURES, measured, run_episodes
from rl.experiments.named import named_controllers
from rl.experiments.reality import real_world
from rl.experiments.statistics import expected
from rl.experiments.testbeds import Controllers, SimulationSettings
from rl.forecast.forecast import SEALED, Forecast
from rl.forecast.realities import (
    DEVIATIONS,
    TWIN_ERROR,
    Realities,
    draw_realities,
    read_diagnosed,
    residuals_of,
)
from rl.forecast.swims import Forecaster
from rl.forecast.trials import OBSERVED, Trials
from rl.make import noise_of, with_density
from rl.sac.plan import RECIPES
from rl.task import CONTROL_S, TASKS, Starts, Task
from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import with_values
from sim.twin.law import FITTED
from sim.twin.twin import Twin
from sim.verbs import calibrate, diagnose
from sim2real.arrays import Array
from sim2real.diagnose.result import write_diagnosis
from sim2real.effects import BODY
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.output import write_json
from sim2real.posterior.posteriors import JointSample
from sim2real.ranges.entry import Ranges, normal, uniform
from sim2real.recording import Recording, read_recording, write_recording
from sim2real.robot import read_robot

POOL = ROOT / "datasets" / "pool"
AGENTS = POOL / "agents" / "ablation"
POLICIES = [
    *(str(AGENTS / name / "policy.npz") for name in (
        "full-0", "full-1", "no-servo-0", "no-density-0", "no-randomization-0",
        "no-randomization-1",
    )), "pnl", "adrc",
]  # fmt: skip
FIRST = 0
"""The policy with more trials, for the update."""
Add = Callable[[str, float], None]
LAW_SD = 0.15
"""Standard deviation of the logarithm of the coefficients of a water, with ``--twin``."""
SCORED = ("time_s", "energy", "success")


def task_of(seconds: float) -> Task:
    """The turn, with a limit of time."""
    steps = round(seconds / CONTROL_S)
    return replace(TASKS["turn"], steps=steps, energy=RECIPES["default"].task.energy)


def concealed(rng: np.random.Generator) -> tuple[Any, dict[str, list[float]]]:
    """A reality, and what a bench gives for its servos."""
    from drawn import NOMINAL, OUTSIDE, WEAKEST  # type: ignore[import-not-found]
    from truth import Truth  # type: ignore[import-not-found]

    kp = np.array([2.1, 2.0, 1.9]) * rng.uniform(0.85, 1.15, 3)
    kd = np.array([0.075, 0.07, 0.066]) * rng.uniform(0.85, 1.15, 3)
    latency = np.array([0.062, 0.066, 0.071]) + rng.uniform(-0.012, 0.012)
    effects: dict[str, dict[str, float]] = {}
    choices = [n for n in NOMINAL if not n.startswith(("camera", "marker", "pose", "dropped"))]
    if rng.random() < 0.6:
        name = choices[rng.integers(len(choices))]
        strength = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(1.5))))
        effects[name] = {k: float(x) for k, x in NOMINAL[name](rng, strength).items()}
    servo = {
        "coulomb_friction": {"torque_Nm": rng.uniform(0.01, 0.05)},
        "backlash": {"gap_rad": rng.uniform(0.005, 0.03)},
        "latency_drift": {"sd_s": rng.uniform(0.003, 0.01), "time_s": 3.0},
    }
    effects |= {name: values for name, values in servo.items() if rng.random() < 0.5}
    if rng.random() < 0.2:
        name = ("seiche", "leaking_float", "loose_fin")[rng.integers(3)]
        effects[name] = {k: float(x) for k, x in OUTSIDE[name](rng).items()}
        effects[name] = {k: 1.0 if k == "from_s" else x for k, x in effects[name].items()}
    bench = {
        "kp": kp * rng.uniform(0.95, 1.05, 3),
        "kd": kd * rng.uniform(0.95, 1.05, 3),
        "latency": latency + rng.uniform(-0.004, 0.004, 3),
    }
    rows = (tuple(map(float, row)) for row in (kp, kd, latency))
    return Truth("reality", effects, *rows), {k: x.tolist() for k, x in bench.items()}


def servos_of(names: Sequence[str], *values: Sequence[float]) -> Model:
    """Servos with these kp, kd and latencies."""
    rows = zip(names, *values, strict=True)
    return Model({name: JointModel(*row, 0.002) for name, *row in rows})


def swim_group(options: argparse.Namespace, g: int) -> None:
    """The known swims and the trials of one group of realities, which share their water."""
    from camera import filmed, reported  # type: ignore[import-not-found]
    from drawn import command_of, water_of
    from reality import Pool  # type: ignore[import-not-found]
    from world import World  # type: ignore[import-not-found]

    rng, robot = np.random.default_rng([options.seed, g]), read_robot(POOL / "robot.toml")
    R, J, P = options.in_group, len(robot.joints), len(POLICIES)
    truths, benches = zip(*(concealed(rng) for _ in range(R)), strict=True)
    water = water_of(rng)
    cells = {"device": options.device, "cell_m": options.cell_m * rng.uniform(0.9, 1.1)}
    known = World(truths, rng=rng, robot=robot, water=water, **cells)
    command = np.stack([command_of(rng, J, CONTROL_S, options.known_s) for _ in range(R)], axis=1)
    known.reset(np.column_stack([rng.uniform(-0.5, 0.5, (R, 2)), rng.uniform(-3, 3, R)]))
    pose, angle = [], []
    for row in command:
        at, joint = known.where()
        pose.append(filmed(at, rng))
        angle.append(reported(joint, rng))
        known.step(row)
    lost = known.stopped()
    names = tuple(joint.name for joint in robot.joints)
    for r in range(R):
        folder = options.out / "inputs" / f"{g:02d}-{r:02d}"
        if lost[r]:
            continue
        write_model(servos_of(names, *benches[r].values()), folder / "bench.json")
        _write_known(folder, names, command[:, r], np.array(pose)[:, r], np.array(angle)[:, r])
    # the same starts for all policies, and four more of the first policy
    task, T = task_of(options.seconds), options.trials
    who = np.array([*np.repeat(np.arange(P), T), *[FIRST] * 4])
    which = np.array([*np.tile(np.arange(T), P), *range(T, T + 4)])
    starts = [task.place(rng, T + 4, J) for _ in range(R)]
    parts = (np.concatenate([one[k][which] for one in starts]) for k in range(3))
    world = World(
        [truth for truth in truths for _ in who], rng=rng, robot=robot, water=water, **cells
    )
    controllers = named_controllers(POLICIES, robot)
    owner = np.tile(who, R)
    steering = Controllers([*controllers.values()], 1)
    steering.owner = owner
    seen = real_world(Pool(world, rng), robot, task, Starts(*parts), "pool")
    episodes = run_episodes(seen, steering, name="reality")
    figures = {name: x.reshape(R, len(who)) for name, x in measured(episodes, task).items()}
    stopped = world.stopped().reshape(R, len(who))
    content = {name: x.tolist() for name, x in figures.items()}
    effects = [truth.effects for truth in truths]
    about = {"who": who.tolist(), "stopped": stopped.tolist(), "lost": lost.tolist()}
    _seal(options.out, g, {**content, **about, "effects": effects, "water": vars(water)})


def _write_known(
    folder: Path, names: Sequence[str], command: Array, pose: Array, angle: Array
) -> None:
    """Write the swim that is known of a reality: set-points (T, J), poses (T, 3), angles (T, J)."""
    columns = dict(zip(("body.x_m", "body.y_m", "body.yaw_rad"), pose.T, strict=True))
    recording = Recording(
        name="known", kind="pool", joints=tuple(names), t=CONTROL_S * np.arange(len(command)),
        command=command, position=angle, columns=columns, medium="water",
        source="Simulated, not measured: benchmarks/forecast_realities.py. MIT licence.",
    )  # fmt: skip
    write_recording(recording, folder / "known.csv")


def _seal(out: Path, g: int, content: dict[str, Any]) -> None:
    """Write the answers of a group and print their hash."""
    answers = write_json(out / "answers" / f"{g:02d}.json", content)
    stopped = int(np.sum(content["stopped"]))
    print(g, hashlib.sha256(answers.read_bytes()).hexdigest(), stopped, flush=True)


def _of_library(effects: dict[str, dict[str, float]], joints: Sequence[str]) -> dict[str, float]:
    """Concealed effects that the library has too, by the names of its values; others are left."""
    known, out = {effect.name for effect in BODY}, {}
    for name, values in effects.items():
        for key, x in values.items():
            if name.partition(".")[0] in known:
                out[f"{name}.{key}"] = float(x)
            elif name == "coulomb_friction":  # of one joint, or the same of all
                joint, _, parameter = key.rpartition(".")
                for each in [joint] if joint else joints:
                    out[f"{each}.{name}.{parameter}"] = float(x)
    return out


def twin_group(options: argparse.Namespace, g: int) -> None:
    """The known swims and the trials of one group of realities that are twins of one water."""
    from camera import filmed, reported
    from drawn import command_of

    rng, robot = np.random.default_rng([options.seed, g]), read_robot(POOL / "robot.toml")
    R, J, names = options.in_group, len(robot.joints), [joint.name for joint in robot.joints]
    water = {f"twin.{k}": v * np.exp(rng.normal(0, LAW_SD)) for k, v in vars(FITTED).items()}
    models, effects = [], []
    for r in range(R):
        truth, bench = concealed(rng)
        inside = _of_library(truth.effects, names)
        servos = servos_of(names, truth.kp, truth.kd, truth.latency)
        models.append(with_values(with_density(servos, robot), {**water, **inside}))
        effects.append(inside)
        folder = options.out / "inputs" / f"{g:02d}-{r:02d}"
        write_model(servos_of(names, *bench.values()), folder / "bench.json")
        command = command_of(rng, J, CONTROL_S, options.known_s)
        start = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3)])
        track = Twin(robot, models[-1]).swum(command, start)[0]
        _write_known(folder, names, command, filmed(track[:, :3], rng), reported(track[:, 3:], rng))
    law = rng.standard_normal((R, 4)) * [*LAW_ERROR.shares[(0, 1, 2), (0, 1, 0)], 0.0]
    energy = json.loads(TWIN_ERROR.read_text())["energy"]
    law[:, 3] = np.expm1(rng.normal(energy["mean"], energy["sd"], R))
    noise = noise_of(known_of(read_model(folder / "bench.json"), rng)[0], names)
    real = Realities(tuple(models), noise, (), np.zeros((R, 0)), law, np.zeros(3 + J))
    task, T = task_of(options.seconds), options.trials
    controllers = named_controllers(POLICIES, robot)
    first = dict([list(controllers.items())[FIRST]])
    simulation = SimulationSettings(threads=1)
    parts = [
        Forecaster(robot, task, real, n, options.seed + k, simulation, at_once=R).swim(some)
        for k, (some, n) in enumerate(((controllers, T), (first, 4)))
    ]
    figures = {
        name: np.concatenate([np.moveaxis(p[name], 0, 1).reshape(R, -1) for p in parts], axis=1)
        for name in FIGURES
    }
    who = [*np.repeat(np.arange(len(POLICIES)), T).tolist(), *[FIRST] * 4]
    still = np.zeros((R, len(who)), bool).tolist()
    about = {"who": who, "stopped": still, "effects": effects, "water": water}
    _seal(options.out, g, {**{name: x.tolist() for name, x in figures.items()}, **about})


def known_of(bench: Model, rng: np.random.Generator) -> tuple[Ranges, JointSample]:
    """Ranges and posterior of a bench whose values are off by up to 5 %, and 4 ms."""
    gains = ("kp_Nm_per_rad", "kd_Nms_per_rad")
    names = tuple(f"{joint}.{gain}" for joint in bench.joints for gain in gains)
    value = np.array([getattr(bench.joints[n.split(".")[0]], n.split(".")[1]) for n in names])
    sample = value / rng.uniform(0.95, 1.05, (2000, len(names)))
    latency = np.array([joint.latency_s for joint in bench.joints.values()])
    entries = [uniform(n, 0.95 * v, 1.05 * v, "", "") for n, v in zip(names, value, strict=True)]
    entries.append(uniform("command_latency_s", latency.mean(), latency.mean(), "s", ""))
    for joint, at in zip(bench.joints, latency - latency.mean(), strict=True):
        entries.append(uniform(f"{joint}.latency_offset_s", at - 0.004, at + 0.004, "s", ""))
        entries.append(normal(f"{joint}.position_noise_rad", 0, 0.0019, "rad", "", "step"))
    entries.append(normal("body.position_noise_m", 0, 0.002, "m", "", "step"))
    entries.append(normal("body.yaw_noise_rad", 0, 0.009, "rad", "", "step"))
    return Ranges(tuple(entries)), JointSample(names, ("",) * len(names), sample)


def hand_set(ranges: Ranges) -> Ranges:
    """The paper's Table II: latency 68 +- 20 ms; noise of 5 cm, 3 degrees, joints 2 degrees."""
    noise = {"body.position_noise_m": 0.05, "body.yaw_noise_rad": np.deg2rad(3.0)}
    entries = [uniform("command_latency_s", 0.048, 0.088, "s", "")]
    for entry in ranges.entries:
        if entry.period == "step":
            sd = noise.get(entry.parameter, np.deg2rad(2.0))
            entries.append(replace(entry, second=float(sd)))
    return Ranges(tuple(entries))


def forecast_one(folder: Path, draws: int, seconds: float) -> str:
    """Calibrate and forecast one reality from its inputs."""
    import torch

    torch.set_num_threads(1)
    out = folder.parents[1] / "forecasts" / f"{folder.name}.npz"
    if out.exists():
        return f"{folder.name}: kept"
    out.parent.mkdir(parents=True, exist_ok=True)
    robot, bench = read_robot(POOL / "robot.toml"), read_model(folder / "bench.json")
    recording, task = read_recording(folder / "known.csv"), task_of(seconds)
    rng = np.random.default_rng(0)
    ranges, sample = known_of(bench, rng)
    diagnosis, calibrated = out.with_suffix(".json"), out.with_suffix(".model.json")
    if not calibrated.exists():
        found = diagnose([recording], robot, bench)
        write_diagnosis(found, diagnosis, "enriched.json")
        write_model(calibrate([recording], robot, found.model).model, calibrated)
    model = read_model(calibrated)
    residuals = residuals_of([recording], model, robot)
    controllers = named_controllers(POLICIES, robot)
    few = dict(list(controllers.items())[:2])
    simulation = SimulationSettings(threads=1)
    model = with_density(model, robot)
    diagnosed = read_diagnosed(diagnosis)
    drawn = draw_realities(robot, model, ranges, sample, draws, rng, diagnosed=diagnosed)
    content: dict[str, Any] = {"names": np.array(drawn.names), "parameters": drawn.values}
    swum = Forecaster(robot, task, drawn, 2, 1, simulation, residuals, draws).swim(controllers)
    content |= {f"full.{name}": swum[name] for name in FIGURES}
    by_hand = draw_realities(robot, model, hand_set(ranges), sample, draws, rng)
    flat = replace(by_hand, law=np.zeros((draws, 4)), unexplained=np.zeros(6))
    body = {k: x for k, x in model.body.items() if k not in ("posterior", "interval")}
    models = tuple(replace(m, body={**body, "effects": []}) for m in flat.models)
    flat = replace(flat, models=models)
    swum = Forecaster(robot, task, flat, 2, 1, simulation, at_once=draws).swim(few)
    content |= {f"hand.{name}": swum[name] for name in FIGURES}
    np.savez_compressed(out.with_suffix(".part.npz"), **content)
    out.with_suffix(".part.npz").rename(out)
    return f"{folder.name}: {model.fit['body.surge']['heldout']:.3f} m/s"


def forecast_of(kept: Any, kind: str) -> Forecast:  # noqa: ANN401 - an open npz
    """A forecast from what was kept of it."""
    figures = {name: kept[f"{kind}.{name}"] for name in FIGURES}
    K = len(figures["time_s"])
    names, policies = tuple(map(str, kept["names"])), tuple(map(str, range(K)))
    none, joints = np.zeros((K, 0, 0, 2)), ("j1", "j2", "j3")
    return Forecast("", "turn", policies, joints, figures, names, kept["parameters"], none, none)


def answered(out: Path) -> Iterator[tuple[Path, int, Array, Array, dict[str, Array]]]:
    """Of each forecast its file and water; of its trials the policy, whether whole, figures."""
    for path in sorted((out / "forecasts").glob("??-??.npz")):
        g, r = map(int, path.stem.split("-"))
        answers = json.loads((out / "answers" / f"{g:02d}.json").read_text())
        real = {name: np.array(answers[name], dtype=np.float64)[r] for name in FIGURES}
        yield path, g, np.array(answers["who"]), ~np.array(answers["stopped"])[r], real


def score(out: Path) -> dict[str, Any]:
    """Compare the forecasts with the answers."""
    rows: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        rows.setdefault(name, []).append(float(value))

    for path, _, who, ok, real in answered(out):
        with np.load(path, allow_pickle=False) as kept:
            made = {kind: forecast_of(kept, kind) for kind in ("full", "hand")}
        for kind, one in made.items():
            for k, policy in enumerate(one.policies):
                mine = (who == k) & ok
                for name in SCORED:
                    if not mine.any():
                        continue
                    values, n = real[name][mine], int(mine.sum())
                    _, low, high = one.interval(policy, name, n)
                    add(f"{kind} mean {name} held", low - 1e-9 <= values.mean() <= high + 1e-9)
                    _, least, most = one.interval(policy, name)
                    add(f"{kind} mean {name} width", most - least)
                    _, low, high = one.interval(policy, name, 1)
                    add(f"{kind} next {name} held", low - 1e-9 <= values[0] <= high + 1e-9)
                    add(f"{kind} next {name} width", high - low)
        scored(made["full"], real, who, ok, add)
        updated(made["full"], real, who, ok, add)
    return summary(rows)


def scored(full: Forecast, real: dict[str, Array], who: Array, ok: Array, add: Add) -> None:
    """The ranking of policies by the forecast, and by one real trial of each.

    The forecast is held against the mean of the trials, and one trial of each policy against
    another, from other starts: a ranking is no better known than that.
    """
    mine = [np.flatnonzero((who == k) & ok) for k in range(len(full.policies))]
    T = min(map(len, mine))
    for name in ("reward", "time_s", "energy") if T else ():
        sign = FIGURES[name].better
        predicted = np.array([expected(x).mean() for x in sign * full.figures[name]])
        trials = sign * np.stack([real[name][rows[:T]] for rows in mine], axis=1)
        pairs = [("", predicted, trials.mean(axis=0))]
        pairs += [(", trial against trial", *two) for two in permutations(trials, 2)]
        for kind, ranked, found in pairs:
            add(f"ranking tau {name}{kind}", kendalltau(ranked, found).statistic)


def updated(full: Forecast, real: dict[str, Array], who: Array, ok: Array, add: Add) -> None:
    """The update by three trials of the first policy, held against its other trials."""
    mine = np.flatnonzero((who == FIRST) & ok)
    if len(mine) < 6:
        return
    seen = np.stack([real[name][mine[:3]] for name in OBSERVED], axis=1)
    after = full.after([Trials(FIRST, OBSERVED, seen)])
    assert after.update is not None
    add("update contradicted", after.update.contradicted)
    add("update effective", after.update.effective)
    for name in ("time_s", "energy"):
        left = real[name][mine[3:]]
        _, low, high = after.interval("0", name, len(left))
        add(f"update {name} held", low <= left.mean() <= high)
        (_, a, b), (_, c, d) = full.interval("0", name), after.interval("0", name)
        add(f"update {name} narrower", 1 - (d - c) / max(b - a, 1e-9))


def summary(rows: dict[str, Sequence[float]]) -> dict[str, Any]:
    """Shares of what held, medians of all else."""
    out: dict[str, Any] = {}
    for name, values in rows.items():
        share = name.endswith(("held", "contradicted"))
        out[name] = float(np.mean(values) if share else np.median(values))
        print(f"{name:<55} {out[name]:8.3g}   ({len(values)})")
    for name in SCORED[:2]:
        full, hand = (np.median(rows[f"{kind} next {name} width"]) for kind in ("full", "hand"))
        out[f"width of {name} over hand-set"] = float(full / hand)
        print(f"width of {name} over hand-set: {full / hand:.2f}")
    return out


def state(of: str, realities: int, found: dict[str, Any]) -> None:
    """State on the page of forecasts what their intervals were worth on a set."""
    names = [f"{kind} {name}" for kind in ("mean", "next") for name in SCORED]
    held = {name: found[f"full {name} held"] for name in names}
    others = [entry for entry in json.loads(SEALED.read_text())["sets"] if entry["of"] != of]
    write_json(SEALED, {"sets": [*others, {"of": of, "realities": realities, "held": held}]})


def robust(errors: Array) -> tuple[float, float]:
    """Median of errors, and their standard deviation beyond the forecasts' own, shape (n, 2).

    Columns are the error and the standard deviation of what was forecast without it.
    """
    low, middle, high = np.quantile(errors[:, 0], [0.16, 0.5, 0.84])
    variance = ((high - low) / 2) ** 2 - np.median(errors[:, 1] ** 2)
    return float(middle), float(np.sqrt(max(variance, 0.0)))


def energy_error(out: Path) -> None:
    """Measure the error of energy and write it."""
    ratio: dict[int, list[tuple[float, float]]] = {}
    realities = 0
    for path, g, who, ok, real in answered(out):
        with np.load(path) as kept:
            error = kept["parameters"][:, list(kept["names"]).index(DEVIATIONS[3])]
            forecast = np.log(kept["full.energy"] / (1 + error[:, None])).mean(axis=2)
        for k in set(who[ok]):
            found = float(np.log(real["energy"][(who == k) & ok]).mean() - forecast[k].mean())
            ratio.setdefault(g, []).append((found, float(forecast[k].std())))
        realities += 1
    for g in ratio:
        others = [x for k, values in ratio.items() if k != g for x in values]
        print("without water", g, *robust(np.array(others)))
    middle, sd = robust(np.array([x for values in ratio.values() for x in values]))
    origin = {"waters": len(ratio), "realities": realities}
    write_json(TWIN_ERROR, {"from": origin, "energy": {"mean": middle, "sd": sd}})


def main(arguments: Sequence[str] | None = None) -> None:
    """One stage."""
    parser = command_line(
        __doc__, device="cpu", processes=1, seed=20261126, groups=4, in_group=25, cell_m=0.016,
        trials=(2, "of each policy in a reality"), seconds=(10.0, "longest trial"),
        known_s=(12.0, "length of the known swim"), draws=100,
        state=("", "what the set is: its score is stated on the page of forecasts"),
    )  # fmt: skip
    parser.add_argument("--twin", action="store_true", help="swim in twins with laws of their own")
    parser.add_argument("stage", choices=("swim", "forecast", "score", "energy"))
    parser.add_argument("out", type=Path)
    options = parser.parse_args(arguments)
    if options.stage == "swim":
        sys.path.insert(0, str(POOL))
        for g in range(options.groups):
            if not (options.out / "answers" / f"{g:02d}.json").exists():
                (twin_group if options.twin else swim_group)(options, g)
    elif options.stage == "forecast":
        # one of each water after the other, so that a part of them is of all waters
        folders = sorted((options.out / "inputs").iterdir(), key=lambda one: one.name[::-1])
        work = partial(forecast_one, draws=options.draws, seconds=options.seconds)
        for told in spread(work, folders, options.processes, unit="reality", in_order=False):
            print(told, flush=True)
    elif options.stage == "score":
        found = score(options.out)
        write_json(options.out / "score.json", found)
        if options.state:
            state(options.state, len([*answered(options.out)]), found)
    else:
        energy_error(options.out)


if __name__ == "__main__":
    main()
