"""``sim2real diagnose``: servos, or the body if the recordings are swims in a pool."""

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
    plan = diagnosis.next_experiment
    if plan is not None and plan.t is not None and plan.signal is not None:
        path = beside(out, f"{out.stem}.next.csv")
        load = diagnosis.model.joints[plan.component].load
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
        diagnosis = replace(diagnosis, next_experiment=replace(plan, file=path.name))
    enriched = beside(out, f"{out.stem}.enriched.json")
    write_model(diagnosis.model, enriched)
    write_diagnosis(diagnosis, out, enriched.name)


def _shown(
    diagnosis: Diagnosis, recordings: list[Recording], robot: Robot, options: argparse.Namespace
) -> tuple[Callable[[], Section], Callable[[], Scene]]:
    """Functions that make the section of a page, and the scene for viewers."""
    shown = not options.no_page or options.rerun or options.mcap
    if not (shown and recordings[0].is_swim):
        return lambda: diagnosis_section(diagnosis), lambda: diagnosed(diagnosis)
    from sim.inference.in_water import robot_in_water
    from sim.inference.swims import swim_of
    from sim.view.swim_page import swims_scene, swims_section

    swims = [swim_of(recording, robot) for recording in recordings]
    files = [options.in_water] if options.in_water else []
    _, corrected = robot_in_water(robot, read_model(options.model), files)
    # there is none where the fluid was simulated again
    simulate = None if files and options.device != "cpu" else corrected
    return (
        lambda: swims_section(diagnosis, swims, simulate, robot),
        lambda: swims_scene(diagnosis, recordings, swims, simulate, robot),
    )
