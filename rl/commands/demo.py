"""``sim2real demo``: the whole chain on the shipped data, ending in one HTML page."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from rl.commands.ablate import tried_in
from rl.commands.demo_swim import swim_section
from rl.experiments.ablation import ablate
from rl.experiments.ablation_report import (
    difference_figure,
    keeps,
    markdown,
    power,
    return_figure,
    rows,
    way_figure,
    write_report,
)
from rl.experiments.arms import PAPER, arm_of
from rl.experiments.differences import differences
from rl.sac.recipes import plan_of
from rl.sac.train import Plan, train_in_parts
from sim.inference.calibrate import calibrate
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.followed import by_followed_twin
from sim.inference.parameters import law_parameters, servo_parameters
from sim.inference.swims import by_twin, swim_of
from sim.view.calibration_page import calibration_section
from sim.view.diagnosis_page import swims_section
from sim2real.check import check
from sim2real.commands.diagnose import write as write_servos
from sim2real.commands.identify import most_telling
from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.result import write_diagnosis
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.model import Model, read_model, write_model
from sim2real.output import check_writable
from sim2real.ranges.entry import write_ranges
from sim2real.ranges.gather import Gathered, gather
from sim2real.recording import Recording, read_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.drawing import svg
from sim2real.report.identification import Fit, identification_section
from sim2real.report.page import Figure, Note, Section, write_page
from sim2real.report.ranges import ranges_section
from sim2real.report.recordings import recordings_section
from sim2real.report.style import NARROW
from sim2real.report.table import fit_report
from sim2real.robot import Robot, read_robot
from sim2real.servo.replay import Replay, replay

STAGES = ("recordings", "check", "identify", "diagnose", "calibrate", "ranges", "ablate", "swim")
_TELLING = ("chirp", "steps")
_SHOWN = "square"
"""Recording that the page shows beside the one held out: the paper's own test signal."""


_SWIMS = ("p1", "p2")
"""Swims of the pool: the first is calibrated on, ranges take both."""
QUICK = plan_of({"recipe": "brief"}, fidelity="twin", threads=2)
"""What each arm of the ablation learns beyond the agents that all go on from."""
SEEDS, REPEATS = 8, 12


def run(options: argparse.Namespace) -> int:
    """Bench, pool, ablation; write ``index.html`` and what stands behind it."""
    page = check_writable(options.out / "index.html")
    torch.set_num_threads(1)
    bench, robot, model = _bench(options)
    pool = _pool(options)
    with _stage("report", str(page)):
        write_page(
            page,
            robot.name,
            f"{len(model.joints)} servos identified, a body calibrated, techniques compared",
            [*bench, *pool],
            model.provenance,
            stages=[(name, True) for name in STAGES],
        )
    print("\n" + fit_report(model))
    print(f"\nreport: {page}")
    return 0


def _bench(options: argparse.Namespace) -> tuple[list[Section], Robot, Model]:
    """Servos on a bench: recordings, identification, diagnosis."""
    paths = sorted(options.data.glob("*.csv"), reverse=True)  # the chirp last: it is held out
    if not paths:
        raise InputError(options.data, "", "no recordings", "NAME.csv files, NAME.json beside each")
    robot = read_robot(options.data / "robot.toml")
    with _stage("read", f"{len(paths)} recordings of {options.data}"):
        recordings = [read_recording(path) for path in paths]
    with _stage("check", "clocks, noise, motion"):
        checks = [check(recording, robot) for recording in recordings]
    with _stage("identify", "gains and latency of each servo"):
        model = identify(recordings, robot, seed=options.seed)
    with _stage("diagnose", "which physics the servos leave out"):
        found = diagnose(_two(recordings), robot, seed=options.seed)
    write_servos(found, options.out / "diagnosis.json")
    with _stage("replay", "the model beside what was recorded"):
        replays = replay(model, recordings)
    write_model(model, options.out / "model.json")
    sections = [
        recordings_section(recordings, checks),
        identification_section(model, _shown(replays)),
        diagnosis_section(found),
    ]
    return sections, robot, model


def _pool(options: argparse.Namespace) -> list[Section]:
    """A robot in a pool: calibration, diagnosis, ranges, a quick ablation."""
    folder: Path = options.pool
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    recordings = [read_recording(folder / f"{name}.csv") for name in _SWIMS]
    swim, twin = swim_of(recordings[0], robot), by_twin(robot)
    with _stage("calibrate", f"the body in the twin, on {recordings[0].name}"):
        free = [*law_parameters(), *servo_parameters(model, robot)]
        fitted = calibrate([swim], model, free, twin)
    followed = by_followed_twin(robot)
    with _stage("diagnose", f"which physics the body leaves out, on {swim.name}"):
        missing = diagnose_swims([swim], model, robot, followed)
    write_model(missing.model, options.out / "swim.enriched.json")
    write_diagnosis(missing, options.out / "swim.json", "swim.enriched.json")
    with _stage("ranges", "what to randomize, and how far"):
        found = gather(recordings, robot, fitted.model)
    write_model(fitted.model, options.out / "calibrated.json")
    write_ranges(found.ranges, options.out / "ranges.json")
    told, plan = _ablated(options, robot, fitted.model, found)
    return [
        calibration_section(swim, model, fitted, twin, robot),
        replace(swims_section(missing, [swim], followed, robot), title="Diagnosis of the swim"),
        ranges_section(found),
        _ablation(told, plan),
        _swim(told, options, robot, fitted.model),
    ]


def _ablated(
    options: argparse.Namespace, robot: Robot, model: Model, found: Gathered
) -> tuple[dict[str, Any], Plan]:
    """A quick ablation in the twin: what ``ablate`` tells of it, and how it trained."""
    arms = [arm_of(name, model, robot, found.ranges) for name in PAPER]
    reality = read_model(options.pool / "reality.json")
    plan = replace(QUICK, seeds=tuple(range(options.seed, options.seed + SEEDS)))
    folder = options.out / "ablation"
    trainer = partial(train_in_parts, first=agents_in(options.pool))
    with _stage("ablate", f"{len(arms)} arms, {SEEDS} seeds, {plan.steps} steps, in the twin"):
        testbeds = tried_in(robot, arms, plan, found.ranges, reality)
        told = ablate(
            folder, robot, arms, plan, testbeds, seed=options.seed, repeats=REPEATS, trainer=trainer
        )
    write_report(told, plan, folder, model.provenance)
    print(markdown(told))
    return told, plan


def agents_in(pool: Path) -> list[Path]:
    """The agents that arms go on from: they swim half way between no technique and all."""
    found = sorted((pool / "agents").glob("*.zip"))
    if not found:
        raise InputError(
            pool / "agents", "", "no agents", "NAME.zip files, such as of the arm midway"
        )
    return found


def _ablation(told: dict[str, Any], plan: Plan) -> Section:
    """The chain's last stage, not its result."""
    note = (
        f"Agents of a seed go on from one shipped with the data, whose servos and densities lay "
        f"half way between the calibrated ones and the old simulator's, for {plan.steps} steps in "
        "their own arm's: pairs differ by their arms. A difference whose interval leaves out zero "
        "stands out. Reality is the twin with other numbers, friction, play and a skin here, as a "
        "pool of its own is too slow for two cores. Of a hundred such ablations 97 or more tell "
        "the servo's calibration, twenty another technique by chance. Learned from nothing and "
        "swum in the fluid, the servo's is worth most by far (reports/ablation)."
    )
    apart = differences(told)
    captions = ("", power(apart), "")
    drawn = (return_figure(rows(told)), difference_figure(apart), way_figure(told))
    figures = [
        Figure(svg(one), caption, svg(one, width=NARROW))
        for one, caption in zip(drawn, captions, strict=True)
    ]
    lead = keeps({row["arm"]: row for row in rows(told)})
    return Section("A quick ablation", lead, [Note("info", note), *figures])


def _swim(told: dict[str, Any], options: argparse.Namespace, robot: Robot, model: Model) -> Section:
    """What an agent with all techniques has learned, to watch: the best of them in simulation."""
    mine = [agent for agent in told["agents"] if agent["arm"] == "all"]
    best = max(mine, key=lambda agent: fmean(agent["simulation"]["return"]))
    (policy,) = (options.out / "ablation" / "train").glob(f"*/{best['folder']}/policy.zip")
    film = check_writable(options.out / "swim.gif")
    with _stage("swim", "the policy with all techniques, in the fluid"):
        return swim_section(policy, robot, model, film, options.seed)


def _two(recordings: Sequence[Recording]) -> list[Recording]:
    """Two recordings of different kinds: enough, and quick."""
    telling = [one for one in recordings if one.name in _TELLING]
    return telling or list(recordings[:2])


def _shown(replays: Sequence[Replay]) -> list[Fit]:
    telling = list(most_telling(replays).values())
    more = [one for one in replays if one.recording.name == _SHOWN and one not in telling]
    return [(r.recording, r.joint, r.predicted, r.held_out) for r in [*more[:1], *telling]]


@contextmanager
def _stage(name: str, what: str) -> Iterator[None]:
    """Print a line for one stage, and how long it took."""
    print(f"{name:10}{what}", end=" ", flush=True)
    start = time.perf_counter()
    yield
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)
