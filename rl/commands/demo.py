"""``sim2real demo``: the whole chain on the shipped data, ending in one HTML page."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from rl.commands import demo_pool
from rl.commands.alongside import Alongside
from rl.commands.demo_pool import PRETRAINED, Done, Pool, pool_work, run_ablation
from rl.commands.demo_summary import summary_section
from rl.commands.demo_swim import swim_section
from rl.experiments.ablation_report import (
    difference_figure,
    markdown,
    retention_text,
    return_figure,
    rows,
    seeds_text,
    trajectory_figure,
    write_report,
)
from rl.experiments.differences import differences
from rl.experiments.pretrained import Pretrained, read_pretrained
from sim.commands.diagnose import write_all
from sim.inference.followed import by_followed_twin
from sim.inference.swims import by_twin
from sim.view.swim_page import calibration_section, swims_section
from sim2real.check import check
from sim2real.commands.recordings import most_held_out
from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.model import Model, write_model
from sim2real.output import check_writable
from sim2real.ranges.entry import write_ranges
from sim2real.recording import Recording, read_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.drawing import svg
from sim2real.report.identification import Fit, identification_section
from sim2real.report.page import Block, Figure, Note, Section, write_page
from sim2real.report.ranges import ranges_section
from sim2real.report.recordings import recordings_section
from sim2real.robot import Robot, read_robot
from sim2real.servo.prediction import Replay, replay

_DIAGNOSED = ("chirp", "steps")
_SHOWN = "square"
"""Recording that the page shows with the held-out one: the test signal of the paper."""


def run(options: argparse.Namespace) -> int:
    """Run bench, pool and ablation; write ``index.html`` and the result files."""
    page = check_writable(options.out / "index.html")
    torch.set_num_threads(1)
    work = (options.pool, _ablation_in(options), options.seed, demo_pool.REPEATS, options.train)
    with Alongside(pool_work, *work) as second_process:
        bench, robot, model, servos = _bench(options)
        pool, body, ablation, swim = _pool(options, second_process)
    with _stage("report", str(page)):
        write_page(
            page,
            robot.name,
            f"{len(model.joints)} servos identified, a body calibrated, techniques compared",
            [summary_section(model, servos, body, ablation, swim), *bench, *pool],
            model.provenance,
        )
    print(f"\n{model}")
    print(f"\nreport: {page}")
    return 0


def _bench(options: argparse.Namespace) -> tuple[list[Section], Robot, Model, Diagnosis]:
    """Servos on a bench: recordings, identification, diagnosis."""
    paths = sorted(options.data.glob("*.csv"), reverse=True)  # the chirp last: it is held out
    if not paths:
        raise InputError(options.data, "", "no recordings", "NAME.csv files, each with NAME.json")
    robot = read_robot(options.data / "robot.toml")
    with _stage("read", f"{len(paths)} recordings of {options.data}"):
        recordings = [read_recording(path) for path in paths]
    with _stage("check", "clocks, noise, motion"):
        checks = [check(recording, robot) for recording in recordings]
    with _stage("identify", "gains and latency of each servo"):
        model = identify(recordings, robot, seed=options.seed)
    with _stage("diagnose", "physics missing from the servo model"):
        diagnosis = diagnose(_two(recordings), robot, seed=options.seed)
    write_all(diagnosis, options.out / "diagnosis.json")
    with _stage("replay", "the model on the recordings"):
        replays = replay(model, recordings)
    write_model(model, options.out / "model.json")
    sections = [
        recordings_section(recordings, checks),
        identification_section(model, _shown(replays)),
        diagnosis_section(diagnosis),
    ]
    return sections, robot, model, diagnosis


def _pool(
    options: argparse.Namespace, second_process: Iterator[Done]
) -> tuple[list[Section], Diagnosis, str, Section]:
    """A robot in a pool: diagnosis, calibration, ranges, a quick ablation, a swim.

    Returns:
        The sections, the diagnosis, the ablation's result in a sentence, and the swim's section.
    """
    pool, out = Pool.of(options.pool), options.out
    agents = None if options.train else read_pretrained(options.pool / PRETRAINED)
    robot, swim, followed = pool.robot, pool.swim, by_followed_twin(pool.robot)
    what = f"physics missing from the body model, on {swim.name}"
    missing = _received(second_process, "diagnose", what)
    write_model(missing.model, out / "swim.enriched.json")
    write_diagnosis(missing, out / "swim.json", "swim.enriched.json")
    what = "the body in the twin, with the effects found"
    fitted, drift = _received(second_process, "calibrate", what)
    gathered = _received(second_process, "ranges", "randomization ranges")
    write_model(fitted.model, out / "calibrated.json")
    write_ranges(gathered.ranges, out / "ranges.json")
    if agents is None:
        title = f"{demo_pool.QUICK.steps} steps of each of {demo_pool.SEEDS} seeds of 4 arms"
        with _stage("ablate", f"{title}, in the twin"):
            results = run_ablation(
                pool, fitted.model, gathered, _ablation_in(options), options.seed,
                demo_pool.REPEATS, plan=demo_pool.QUICK, seeds=demo_pool.SEEDS,
            )  # fmt: skip
    else:
        title = f"{len(agents.seeds)} seeds of 4 arms, trained beforehand, in the twin"
        results = _received(second_process, "ablate", title)
    plan = replace(demo_pool.QUICK, seeds=agents.seeds if agents else ())
    write_report(results, plan, _ablation_in(options), fitted.model.provenance)
    print(markdown(results))
    if drift > 1:
        print(f"note: {_drift_warning(drift)}")
    ablation = _ablation(results, agents, drift)
    sections = [
        replace(swims_section(missing, [swim], followed, robot), title="Diagnosis of the swim"),
        calibration_section(swim, pool.model, fitted, by_twin(robot), robot),
        ranges_section(gathered),
        ablation,
    ]
    return sections, missing, ablation.lead, _swim(results, options, robot, fitted.model)


def _ablation_in(options: argparse.Namespace) -> Path:
    """Folder of the ablation, a different one for agents trained in this run."""
    return Path(options.out / ("trained" if options.train else "ablation"))


def _drift_warning(drift: float) -> str:
    """Warning that the shipped agents were trained for another calibration."""
    return (
        "the shipped agents were trained for another calibration: its swim differs from this one's "
        f"by {drift:.1f} times its held-out error; --train trains agents for this one"
    )


def _ablation(results: dict[str, Any], agents: Pretrained | None, drift: float) -> Section:
    """Section on the ablation."""
    steps = demo_pool.QUICK.steps if agents is None else agents.plan["steps"]
    when = "in this run"
    if agents is not None:
        when = (
            "beforehand, by “sim2real demo --train”, and ship with the data; this run evaluates "
            "them in simulation, with its own calibration, and in reality"
        )
    note = (
        f"The agents were trained {when}. "
        "The agents of a seed start from one shipped with the data, trained with servos and "
        "densities half way between the calibrated ones and those of the old simulator, and train "
        f"for {steps} steps in the simulator of their arm: pairs differ only by their arms. A "
        "difference whose interval excludes zero is significant. The reality is here the twin with "
        "other parameters, friction, play and a skin, as a surrogate with its own fluid is too "
        "slow for two cores. Of a hundred such ablations in an earlier version of the twin 97 or "
        "more found the servo calibration significant, twenty another technique by chance. "
        "Trained from scratch and evaluated in the fluid, the servo calibration had by far the "
        "largest effect (reports/ablation)."
    )
    effects_of_arms = differences(results)
    blocks: list[Block] = [Note("info", note)]
    if drift > 1:
        blocks.append(
            Note("warn", _drift_warning(drift)[0].upper() + _drift_warning(drift)[1:] + ".")
        )
    captions = ("", seeds_text(effects_of_arms), "")
    plots = (
        return_figure(rows(results)),
        difference_figure(effects_of_arms),
        trajectory_figure(results),
    )
    figures = [
        Figure(svg(figure), caption) for figure, caption in zip(plots, captions, strict=True)
    ]
    lead = retention_text({row["arm"]: row for row in rows(results)})
    return Section("A quick ablation", lead, [*blocks, *figures])


def _swim(
    results: dict[str, Any], options: argparse.Namespace, robot: Robot, model: Model
) -> Section:
    """Film of a swim of the agent with all techniques that did best in simulation."""
    candidates = [agent for agent in results["agents"] if agent["arm"] == "all"]
    best = max(candidates, key=lambda agent: fmean(agent["simulation"]["return"]))
    if options.train:
        (policy,) = (_ablation_in(options) / "train").glob(f"*/{best['folder']}/policy.zip")
    else:
        policy = options.pool / PRETRAINED / best["folder"] / "policy.npz"
    film = check_writable(options.out / "swim.gif")
    with _stage("swim", "the policy with all techniques, in the fluid"):
        return swim_section(policy, robot, model, film, options.seed)


def _two(recordings: Sequence[Recording]) -> list[Recording]:
    """Two recordings of different kinds: sufficient for a diagnosis, and quick."""
    chosen = [recording for recording in recordings if recording.name in _DIAGNOSED]
    return chosen or list(recordings[:2])


def _shown(replays: Sequence[Replay]) -> list[Fit]:
    chosen = list(most_held_out(replays).values())
    square = [run for run in replays if run.recording.name == _SHOWN and run not in chosen]
    return [(r.recording, r.joint, r.predicted, r.held_out) for r in [*square[:1], *chosen]]


@contextmanager
def _stage(name: str, title: str) -> Iterator[None]:
    """Print the name of a stage and its duration."""
    print(f"{name:10}{title}", end=" ", flush=True)
    start = time.perf_counter()
    yield
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)


def _received(second_process: Iterator[Done], name: str, title: str) -> Any:  # noqa: ANN401 - a result
    """Wait for a stage of the second process, print its duration and return its result."""
    print(f"{name:10}{title}", end=" ", flush=True)
    done = next(second_process)
    print(f"({done.seconds:.1f} s)", flush=True)
    return done.value
