"""``sim2real demo``: the whole chain on the shipped data, ending in one HTML page."""

import argparse
import io
import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import torch

from rl.commands.ablate import make_testbeds
from rl.experiments.ablation import LISTING, PAPER, ablate, arm_of, read_pretrained
from rl.experiments.ablation_report import (
    default_values,
    footer_of,
    markdown,
    sections,
    write_report,
)
from rl.experiments.episodes import run_episodes
from rl.experiments.film import Film
from rl.experiments.named import controller_of
from rl.make import make_world
from rl.sac.plan import plan_of
from rl.sac.train import hide_progress
from rl.task import TASKS
from rl.world import Draws
from sim.commands.diagnose import write_all
from sim.inference.calibration import Calibration, calibrate, calibration_section
from sim.inference.coordinates import twin_parameters
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.swims import by_followed_twin, by_twin, swim_of
from sim.view.swim_page import swims_section
from sim.view.video import Video
from sim2real.check import Check, check
from sim2real.commands.recordings import most_held_out
from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.result import Diagnosis, percent, write_diagnosis
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.model import Model, read_model, write_model
from sim2real.output import check_writable, provenance
from sim2real.ranges.entry import write_ranges
from sim2real.ranges.gather import Gathered, gather
from sim2real.recording import Recording, read_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.identification import identification_section
from sim2real.report.page import Film as Shown
from sim2real.report.page import Note, Section, Table, Text, write_page
from sim2real.report.quantity import milliradians, quantities
from sim2real.report.ranges import ranges_section
from sim2real.report.recordings import recordings_section
from sim2real.robot import Robot, read_robot
from sim2real.servo.prediction import replay

_AIM = (
    "{} servos were identified from recordings of the set-points sent to them and the angles that "
    "they reached, so that a simulator moves as they do and a policy trained in it works on the "
    "robot."
)
LONGEST = 500
"""Longest film in control periods: ten seconds."""
_DIAGNOSED = ("chirp", "steps")
"""Recordings of different kinds: sufficient for a diagnosis, and quick."""
_SHOWN = "square"
"""Recording that the page shows with the held-out one: the test signal of the paper."""
SWIM = "p1"
"""The swim of the pool that is diagnosed, calibrated and gives the ranges."""
QUICK = plan_of({"recipe": "brief"}, fidelity="twin", threads=2)
"""Plan of the training of each arm, which continued from agents that all arms share."""
REPEATS = 12
PRETRAINED = Path("agents") / "ablation"
"""Folder of the pretrained agents of the ablation, relative to that of the pool."""


class Pool(NamedTuple):
    """What is found in the pool."""

    diagnosis: Diagnosis  # what the model of the body leaves out of the swim
    calibration: Calibration  # the body in the twin, fitted to the swim, with the effects found
    gathered: Gathered  # randomization ranges for the calibrated model
    results: dict[str, Any]  # of the ablation of the pretrained agents
    said: str  # printed lines


def run(options: argparse.Namespace) -> int:
    """Run bench, pool and ablation; write ``index.html`` and the result files."""
    page = check_writable(options.out / "index.html")
    torch.set_num_threads(1)
    paths = sorted(options.data.glob("*.csv"), reverse=True)  # the chirp last: it is held out
    if not paths:
        raise InputError(options.data, "", "no recordings", "NAME.csv files, each with NAME.json")
    robot = read_robot(options.data / "robot.toml")
    with _stage("read", f"{len(paths)} recordings of {options.data}"):
        recordings = [read_recording(path) for path in paths]
    with _stage("check", "clocks, noise, motion"):
        checks = [check(recording, robot) for recording in recordings]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn, hide_progress) as second_process:
        pool = second_process.submit(in_pool, options.pool, options.out, options.seed)
        bench, model, servos = _bench(options, robot, recordings, checks)
        found = pool.result()
    print(found.said, end="", flush=True)
    names = ("robot.toml", "model.json", f"{SWIM}.csv", "reality.json", PRETRAINED / LISTING)
    files = [options.data / "robot.toml", *(options.pool / name for name in names)]
    more = provenance(files, None)["inputs"]
    note = {**model.provenance, "inputs": {**model.provenance["inputs"], **more}}
    results, calibration, fish = found.results, found.calibration, found.calibration.robot
    values = default_values(calibration.model, fish)
    write_report(results, QUICK, options.out / "ablation", note, values)
    print(markdown(results))
    swims = swims_section(found.diagnosis, calibration.swims, by_followed_twin(fish), fish)
    table = sections(results, QUICK, values)
    blocks = [_HOW_TRAINED, *(block for one in table[:-1] for block in one.blocks)]
    film = _swim(results, options, fish, calibration.model)
    body = replace(found.diagnosis, model=calibration.model)
    lead = _AIM.format(len(model.joints))
    with _stage("report", str(page)):
        write_page(
            page,
            f"{len(model.joints)} servos, from recordings to training",
            lead,
            [
                _summary(recordings[0].source, model, servos, body, table[0].lead, film),
                *bench,
                replace(swims, title="Diagnosis of the swim"),
                calibration_section(calibration),
                ranges_section(found.gathered),
                Section("A quick ablation", table[0].lead, blocks),
            ],
            footer_of(results, note),
        )
    print(f"\n{model}")
    print(f"\nreport: {page}")
    return 0


def _bench(
    options: argparse.Namespace, robot: Robot, recordings: list[Recording], checks: list[Check]
) -> tuple[list[Section], Model, Diagnosis]:
    """Servos on a bench: identification, diagnosis and their sections."""
    with _stage("identify", "gains and latency of each servo"):
        model = identify(recordings, robot, seed=options.seed)
    with _stage("diagnose", "physics missing from the servo model"):
        chosen = [recording for recording in recordings if recording.name in _DIAGNOSED]
        diagnosis = diagnose(chosen or recordings[:2], robot, seed=options.seed)
    write_all(diagnosis, options.out / "diagnosis.json")
    with _stage("replay", "the model on the recordings"):
        replays = replay(model, recordings)
    write_model(model, options.out / "model.json")
    held_out = list(most_held_out(replays).values())
    square = [run for run in replays if run.recording.name == _SHOWN and run not in held_out]
    shown = [(r.recording, r.joint, r.predicted, r.held_out) for r in [*square[:1], *held_out]]
    made = [recordings_section(recordings, checks), identification_section(model, shown)]
    return [*made, diagnosis_section(diagnosis)], model, diagnosis


def in_pool(folder: Path, out: Path, seed: int) -> Pool:
    """Diagnose, calibrate, derive ranges and test the agents, in a second process.

    The swim is diagnosed before the body is calibrated: without an effect that the robot has, the
    other parameters take values that fit its recording and no other motion.
    """
    robot, servos = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    recording = read_recording(folder / f"{SWIM}.csv")
    swim = swim_of(recording, robot)
    with redirect_stdout(io.StringIO()) as said:
        with _stage("diagnose", f"physics missing from the body model, on {SWIM}"):
            missing = diagnose_swims([swim], servos, robot, by_followed_twin(robot))
        with _stage("calibrate", "the body in the twin, with the effects found"):
            free, twin = twin_parameters(missing.model, robot), by_twin(robot)
            fitted = calibrate([swim], missing.model, free, twin)
        with _stage("ranges", "randomization ranges"):
            gathered = gather([recording], robot, fitted.model)
        with _stage("ablate", "4 arms, trained beforehand, in the twin"):
            agents, seeds = read_pretrained(folder / PRETRAINED, PAPER)
            arms = [arm_of(name, fitted.model, robot, gathered.ranges) for name in PAPER]
            plan, reality = replace(QUICK, seeds=seeds), read_model(folder / "reality.json")
            testbeds = make_testbeds(robot, arms, plan, gathered.ranges, reality)
            how = {"seed": seed, "repeats": REPEATS}
            results = ablate(out / "ablation", robot, PAPER, agents, plan, testbeds, **how)
    write_model(missing.model, out / "swim.enriched.json")
    write_diagnosis(missing, out / "swim.json", "swim.enriched.json")
    write_model(fitted.model, out / "calibrated.json")
    write_ranges(gathered.ranges, out / "ranges.json")
    calibration = Calibration(fitted.model, servos, robot, (swim,), twin, fitted)
    return Pool(missing, calibration, gathered, results, said.getvalue())


_HOW_TRAINED = Note(
    "info",
    "The agents were trained beforehand, by “sim2real ablate --quick”, and ship with the data; "
    "this run evaluates them in simulation, with its own calibration, and in reality. "
    "The agents of a seed start from one shipped with the data, trained with no technique "
    "(servos and density of FishGym, no randomization), and train "
    f"for {QUICK.steps} steps in the simulator of their arm: pairs differ only by "
    "their arms. A difference whose interval excludes zero is significant. The reality is here "
    "the twin with other parameters, friction, play and a skin, as a surrogate with its own "
    "fluid is too slow for two cores. Trained from scratch and evaluated in the fluid, the "
    "servo calibration had by far the largest effect (reports/ablation).",
)


def _swim(
    results: dict[str, Any], options: argparse.Namespace, robot: Robot, model: Model
) -> Section:
    """Film of the agent with all techniques that did best in simulation, in the fluid."""
    candidates = [agent for agent in results["agents"] if agent["arm"] == "full"]
    best = max(candidates, key=lambda agent: fmean(agent["simulation"]["return"]))["folder"]
    policy = options.pool / PRETRAINED / best / "policy.npz"
    film = check_writable(options.out / "swim.gif")
    with _stage("swim", "the policy with all techniques, in the fluid"):
        world = make_world(
            robot, replace(TASKS["turn"], steps=LONGEST), Draws((model,)), n_envs=1,
            fidelity="fluid", seed=options.seed, threads=2,
        )  # fmt: skip
        name = "trained in the twin, tested in the fluid"
        with Video(film) as video, Film(video, world, name, width=480) as watch:
            trial = run_episodes(world, controller_of(str(policy), robot), watch=watch)
    time_s = float(trial.time_s[0])
    outcome = f"It has not arrived after {LONGEST / 50:.0f} s."
    if np.isfinite(time_s):
        outcome = f"It arrives after {time_s:.1f} s."
    lead = (
        "Of the agents with all techniques, the one with the highest return in simulation turns by "
        "180° and swims to a target behind it, in a lattice-Boltzmann fluid with cells of 2 cm. "
        f"It was trained in the twin only. {outcome}"
    )
    caption = (
        "From above: the robot, its path, the target, and the vorticity of the water around it."
    )
    alt = "Film of the simulated fish as it turns and swims to a target, seen from above"
    return Section("A swim", lead, [Shown(film.read_bytes(), alt, caption)])


def _summary(
    source: str, model: Model, servos: Diagnosis, body: Diagnosis, ablation: str, swim: Section
) -> Section:
    """Key numbers, verdicts and the film: the first section of the page."""
    rows = []
    for name, joint in model.joints.items():
        shown = [q for q in quantities(joint) if q.name in ("kp", "kd", "latency")]
        values = ", ".join(f"{q.name} {q.texts[0]} {q.unit}" for q in shown)
        figures = model.fit[f"{name}.position_rad"]
        error, noise = (milliradians(figures.get(key)) for key in ("heldout", "noise"))
        rows.append((f"servo {name}", f"{values}\nheld-out error {error}, sensor noise {noise}"))
    rows += [
        ("missing from the servos", _verdict(servos)),
        ("missing from the body in water", _verdict(body)),
        ("policies trained with it", ablation),
    ]
    lead = (
        "The sections Recordings, Identification and Diagnosis need servos only; “sim2real check”, "
        "“identify” and “diagnose” do the same with yours. The later sections go on with a robot "
        "that swims: its body is calibrated from a recorded swim, and policies trained with and "
        f"without each of these results are compared. These recordings: {source}"
    )
    film = [Text(swim.lead, "A swim of the trained policy"), *swim.blocks]
    return Section("Results", lead, [Table(("what", "result"), rows), *film])


def _verdict(diagnosis: Diagnosis) -> str:
    """The verdict, and below it each effect with its probability."""
    effects = [f"{percent(e.probability)}: {e.statement}" for e in diagnosis.effects]
    verdict = "nothing found" if diagnosis.verdict == "consistent" else diagnosis.verdict
    return "\n".join([verdict.replace("_", " "), *effects])


@contextmanager
def _stage(name: str, title: str) -> Iterator[None]:
    """Print the name of a stage and its duration."""
    print(f"{name:10}{title}", end=" ", flush=True)
    start = time.perf_counter()
    yield
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)
