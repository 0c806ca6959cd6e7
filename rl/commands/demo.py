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
from rl.commands.demo_pool import PRETRAINED, Done, Pool, compared, pool_work
from rl.commands.demo_summary import summary_section
from rl.commands.demo_swim import swim_section
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
from rl.experiments.differences import differences
from rl.experiments.pretrained import Pretrained, read_pretrained
from sim.commands.diagnose import write_all
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.followed import by_followed_twin
from sim.inference.swims import by_twin, swim_of
from sim.view.calibration_page import calibration_section
from sim.view.diagnosis_page import swims_section
from sim2real.check import check
from sim2real.commands.identify import most_held_out
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
from sim2real.report.style import NARROW
from sim2real.report.table import fit_report
from sim2real.robot import Robot, read_robot
from sim2real.servo.replay import Replay, replay

STAGES = ("recordings", "check", "identify", "diagnose", "calibrate", "ranges", "ablate", "swim")
_TELLING = ("chirp", "steps")
_SHOWN = "square"
"""Recording that the page shows beside the one held out: the paper's own test signal."""


def run(options: argparse.Namespace) -> int:
    """Bench, pool, ablation; write ``index.html`` and what stands behind it."""
    page = check_writable(options.out / "index.html")
    torch.set_num_threads(1)
    work = (options.pool, _ablation_in(options), options.seed, demo_pool.REPEATS, options.train)
    with Alongside(pool_work, *work) as beside:
        bench, robot, model, servos = _bench(options)
        pool, body, ablation, swim = _pool(options, beside)
    with _stage("report", str(page)):
        write_page(
            page,
            robot.name,
            f"{len(model.joints)} servos identified, a body calibrated, techniques compared",
            [summary_section(model, servos, body, ablation, swim), *bench, *pool],
            model.provenance,
            stages=[(name, True) for name in STAGES],
        )
    print("\n" + fit_report(model))
    print(f"\nreport: {page}")
    return 0


def _bench(options: argparse.Namespace) -> tuple[list[Section], Robot, Model, Diagnosis]:
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
    write_all(found, options.out / "diagnosis.json")
    with _stage("replay", "the model beside what was recorded"):
        replays = replay(model, recordings)
    write_model(model, options.out / "model.json")
    sections = [
        recordings_section(recordings, checks),
        identification_section(model, _shown(replays)),
        diagnosis_section(found),
    ]
    return sections, robot, model, found


def _pool(
    options: argparse.Namespace, beside: Iterator[Done]
) -> tuple[list[Section], Diagnosis, str, Section]:
    """A robot in a pool: calibration, diagnosis, ranges, a quick ablation, a swim.

    Returns:
        The sections, the diagnosis, the ablation's result in a sentence, and the swim's section.
    """
    pool, out = Pool.of(options.pool), options.out
    agents = None if options.train else read_pretrained(options.pool / PRETRAINED)
    robot, swim = pool.robot, swim_of(pool.recordings[0], pool.robot)
    fitted, drift = _received(beside, "calibrate", f"the body in the twin, on {swim.name}")
    followed = by_followed_twin(robot)
    with _stage("diagnose", f"which physics the body leaves out, on {swim.name}"):
        missing = diagnose_swims([swim], pool.model, robot, followed)
    write_model(missing.model, out / "swim.enriched.json")
    write_diagnosis(missing, out / "swim.json", "swim.enriched.json")
    found = _received(beside, "ranges", "what to randomize, and how far")
    write_model(fitted.model, out / "calibrated.json")
    write_ranges(found.ranges, out / "ranges.json")
    if agents is None:
        what = f"{demo_pool.QUICK.steps} steps of each of {demo_pool.SEEDS} seeds of 4 arms"
        with _stage("ablate", f"{what}, in the twin"):
            told = compared(
                pool, fitted.model, found, _ablation_in(options), options.seed, demo_pool.REPEATS,
                plan=demo_pool.QUICK, seeds=demo_pool.SEEDS,
            )  # fmt: skip
    else:
        what = f"{len(agents.seeds)} seeds of 4 arms, trained beforehand, in the twin"
        told = _received(beside, "ablate", what)
    plan = replace(demo_pool.QUICK, seeds=agents.seeds if agents else ())
    write_report(told, plan, _ablation_in(options), fitted.model.provenance)
    print(markdown(told))
    if drift > 1:
        print(f"note: {_drifted(drift)}")
    ablation = _ablation(told, agents, drift)
    sections = [
        calibration_section(swim, pool.model, fitted, by_twin(robot), robot),
        replace(swims_section(missing, [swim], followed, robot), title="Diagnosis of the swim"),
        ranges_section(found),
        ablation,
    ]
    return sections, missing, ablation.lead, _swim(told, options, robot, fitted.model)


def _ablation_in(options: argparse.Namespace) -> Path:
    """The ablation's folder: of agents that this run trains another than of the shipped ones."""
    return Path(options.out / ("trained" if options.train else "ablation"))


def _drifted(drift: float) -> str:
    """That the shipped agents were trained for another robot than that of this calibration."""
    return (
        "the shipped agents were trained for another calibration: its swim differs from this one's "
        f"by {drift:.1f} times what this one gets wrong; --train trains agents for this one"
    )


def _ablation(told: dict[str, Any], agents: Pretrained | None, drift: float) -> Section:
    """The chain's last stage, not its result."""
    steps = demo_pool.QUICK.steps if agents is None else agents.plan["steps"]
    when = "in this run"
    if agents is not None:
        when = (
            "beforehand, by “sim2real demo --train”, and ship with the data; this run evaluates "
            "them in simulation, with its own calibration, and in reality"
        )
    note = (
        f"The agents were trained {when}. "
        "Agents of a seed start from one shipped with the data, whose servos and densities lay "
        f"half way between the calibrated ones and the old simulator's, and learn for {steps} "
        "steps in their own arm's: pairs differ by their arms. A difference whose interval leaves "
        "out zero is significant. Reality is the twin with other parameters, friction, play and a "
        "skin here, as a pool of its own is too slow for two cores. Of a hundred such ablations 97 "
        "or more find the servo's calibration significant, twenty another technique by chance. "
        "Trained from scratch and evaluated in the fluid, the servo's is worth most by far "
        "(reports/ablation)."
    )
    apart = differences(told)
    blocks: list[Block] = [Note("info", note)]
    if drift > 1:
        blocks.append(Note("warn", _drifted(drift)[0].upper() + _drifted(drift)[1:] + "."))
    captions = ("", power(apart), "")
    drawn = (return_figure(rows(told)), difference_figure(apart), way_figure(told))
    figures = [
        Figure(svg(one), caption, svg(one, width=NARROW))
        for one, caption in zip(drawn, captions, strict=True)
    ]
    lead = keeps({row["arm"]: row for row in rows(told)})
    return Section("A quick ablation", lead, [*blocks, *figures])


def _swim(told: dict[str, Any], options: argparse.Namespace, robot: Robot, model: Model) -> Section:
    """What an agent with all techniques has learned, to watch: the best of them in simulation."""
    mine = [agent for agent in told["agents"] if agent["arm"] == "all"]
    best = max(mine, key=lambda agent: fmean(agent["simulation"]["return"]))
    if options.train:
        (policy,) = (_ablation_in(options) / "train").glob(f"*/{best['folder']}/policy.zip")
    else:
        policy = options.pool / PRETRAINED / best["folder"] / "policy.npz"
    film = check_writable(options.out / "swim.gif")
    with _stage("swim", "the policy with all techniques, in the fluid"):
        return swim_section(policy, robot, model, film, options.seed)


def _two(recordings: Sequence[Recording]) -> list[Recording]:
    """Two recordings of different kinds: enough, and quick."""
    telling = [one for one in recordings if one.name in _TELLING]
    return telling or list(recordings[:2])


def _shown(replays: Sequence[Replay]) -> list[Fit]:
    telling = list(most_held_out(replays).values())
    more = [one for one in replays if one.recording.name == _SHOWN and one not in telling]
    return [(r.recording, r.joint, r.predicted, r.held_out) for r in [*more[:1], *telling]]


@contextmanager
def _stage(name: str, what: str) -> Iterator[None]:
    """Print a line for one stage, and how long it took."""
    print(f"{name:10}{what}", end=" ", flush=True)
    start = time.perf_counter()
    yield
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)


def _received(beside: Iterator[Done], name: str, what: str) -> Any:  # noqa: ANN401 - a result
    """A stage of the second process: its line, its own seconds, its result."""
    print(f"{name:10}{what}", end=" ", flush=True)
    done = next(beside)
    print(f"({done.seconds:.1f} s)", flush=True)
    return done.value
