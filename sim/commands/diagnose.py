"""``sim2real diagnose``: servos, or the body if the recordings are swims in a pool."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim import verbs
from sim2real.commands.command import arguments_of
from sim2real.commands.files import check_written, write_views
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.errors import if_installed
from sim2real.model import read_model, write_model
from sim2real.output import beside
from sim2real.recording import Recording, write_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.page import Section, write_page
from sim2real.robot import Robot, read_robot
from sim2real.verbs import recordings_of
from sim2real.viewers.scenes import Scene, diagnosed


def run(options: argparse.Namespace) -> int:
    """Diagnose, print the diagnosis, write it, the enriched model and a page."""
    check_written(options)
    out = options.out
    robot, recordings = read_robot(options.robot), recordings_of(options.recordings)
    parsed = {"recordings": recordings, "robot": robot, "in_water": options.in_water}
    diagnosis = verbs.diagnose(**arguments_of(verbs.diagnose, options, **parsed))
    write_all(diagnosis, out)
    print(diagnosis)
    section, scene = _shown(diagnosis, recordings, robot, options)
    if not options.no_page:
        page, count = beside(out, f"{out.stem}.html"), len(recordings)
        counted = "1 recording" if count == 1 else f"{count} recordings"
        subtitle = f"{counted}, verdict: {diagnosis.verdict.replace('_', ' ')}"
        with if_installed("page"):
            title = f"Diagnosis of {robot.name}"
            write_page(page, title, subtitle, [section()], diagnosis.provenance)
            print(f"\npage: {page}")
    write_views(options, scene)
    return 0


def write_all(diagnosis: Diagnosis, out: Path) -> None:
    """Write the diagnosis, the enriched model and the commands to repeat, if there are any."""
    enriched = beside(out, f"{out.stem}.enriched.json")
    write_model(diagnosis.model, enriched)
    write_diagnosis(_with_commands(diagnosis, out), out, enriched.name)


def _with_commands(found: Diagnosis, out: Path) -> Diagnosis:
    """The diagnosis, naming the file of the commands to repeat, a recording without positions."""
    plan = found.next_experiment
    if plan is None or plan.t is None or plan.signal is None:
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
        loads={} if load is None else {plan.component: load},
        source="commands to record next, by sim2real diagnose",
    )
    write_recording(recording, path)
    return replace(found, next_experiment=replace(plan, file=path.name))


def _shown(
    diagnosis: Diagnosis, recordings: list[Recording], robot: Robot, options: argparse.Namespace
) -> tuple[Callable[[], Section], Callable[[], Scene]]:
    """Functions that make the section of a page, and the scene for viewers."""
    shown = not options.no_page or options.rerun or options.mcap
    if not (shown and recordings[0].is_swim):
        return lambda: diagnosis_section(diagnosis), lambda: diagnosed(diagnosis)
    from sim.inference.diagnose_swims import simulator_of
    from sim.inference.swims import swim_of
    from sim.view.swim_page import swims_scene, swims_section

    swims = [swim_of(recording, robot) for recording in recordings]
    simulate = simulator_of(robot, read_model(options.model), options.in_water, options.device)
    return (
        lambda: swims_section(diagnosis, swims, simulate, robot),
        lambda: swims_scene(diagnosis, recordings, swims, simulate, robot),
    )
