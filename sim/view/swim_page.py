"""Swims, measured and simulated before and after a fit: panels, sections of pages, scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import (
    HELD_OUT_SHARE,
    Swim,
    SwimSimulator,
    signals_of_robot,
    simulated,
)
from sim2real.diagnose.result import Diagnosis, NamedEffect, Rival, percent
from sim2real.inference.segments import Window
from sim2real.model import Model
from sim2real.recording import POSE, Recording
from sim2real.report.diagnosis import effect_tables, told
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import change_text
from sim2real.report.series import Panel, series_block
from sim2real.robot import Robot
from sim2real.viewers.scenes import MEASURED, Scene, SignalGroup, recorded

_SENTENCES = {
    "consistent": "These swims show no missing effect.",
    "explained": "What was missing from the simulation is identified.",
    "partly_explained": "A part of what is missing is identified; another part is not.",
    "unexplained": "Something is missing that no effect of the catalogue explains.",
    "ambiguous": "Something is missing; these swims do not distinguish its candidates.",
}
_WHERE = (
    "Residual of the model without missing effects, in standard deviations of noise and of the "
    "simulator's usual error: the share of each signal, and the part of the motion that has most "
    "of it in the least time."
)
_COMPARED = (
    "{swim}: measured, and simulated before and after; all models were fitted to all of it. "
    "Shaded: times of large residuals."
)


def swim_panels(
    swim: Swim,
    models: tuple[Model, Model],
    simulator: SwimSimulator,
    robot: Robot,
    *,
    label: str = "calibrated",
    held_out: float = HELD_OUT_SHARE,
    windows_s: Mapping[str, Sequence[Window]] | None = None,
) -> list[Panel]:
    """Surge, sway, yaw rate and the first joint of a swim, measured and simulated.

    The models are those before and after a fit; ``label`` is the name of the second. The share
    ``held_out`` at the end, which the fit did not use, is shaded. ``windows_s``: of these signals,
    by their names in files, which are then all shown, other times are shaded.
    """
    windows_s = windows_s or {}
    before, after = simulated(swim, list(models), simulator)
    end = float(swim.t[-1])
    shaded = [(end * (1 - held_out), end)] if held_out else []
    panels = []
    for k, (in_file, (name, unit)) in enumerate(signals_of_robot(robot).items()):
        signals = {MEASURED: swim.signals[:, k], "before": before[:, k]}
        if models[0] is not models[1]:
            signals[label] = after[:, k]
        if k < 4 or in_file in windows_s:
            group = SignalGroup((swim.name, name), unit, swim.t, signals)
            panels.append(Panel(group, f"{name}, {unit}", windows_s.get(in_file, shaded)))
    return panels


def swims_section(
    diagnosis: Diagnosis, swims: Sequence[Swim], simulate: SwimSimulator | None, robot: Robot
) -> Section:
    """Verdict, effects with probabilities, rivals, errors, and plots of the first few swims."""
    good = diagnosis.verdict in ("consistent", "explained")
    blocks: list[Block] = [Note("good" if good else "info", _SENTENCES[diagnosis.verdict])]
    least = LAW_ERROR.decisions["likely"]
    likely = tuple(effect for effect in diagnosis.effects if effect.probability >= least)
    blocks += [Note("info", told(effect)) for effect in likely]
    blocks += effect_tables(replace(diagnosis, effects=likely))
    plain, enriched = (
        {name: float(e["heldout"] or 0.0) for name, e in fit.items()}
        for fit in (diagnosis.baseline_fit, diagnosis.enriched_fit)
    )
    errors = [
        (name, f"{x:.4g}", f"{enriched[name]:.4g}", change_text(x, enriched[name]))
        for name, x in plain.items()
    ]
    of_errors = (
        "Root mean square error on the end of the swims, fitted to the part before; SI units."
    )
    blocks.append(Table(("signal", "before", "with what is named", ""), errors, of_errors))
    names = signals_of_robot(robot)
    where = [
        (names[entry.signal][0], f"{100 * entry.share:.0f} %", entry.where.partition(", ")[2])
        for entry in diagnosis.mismatch
    ]
    if where:
        blocks.append(Table(("signal", "of the residual", "where that is"), where, _WHERE))
    if simulate is not None and diagnosis.baseline is not None and diagnosis.mismatch:
        enriched_model = diagnosis.baseline if enriched == plain else diagnosis.model
        models = (diagnosis.baseline, enriched_model)
        for swim in swims[:3]:
            panels = swim_panels(
                swim, models, simulate, robot, label="with what is named", held_out=0.0,
                windows_s={m.signal: m.windows_s.get(swim.name, ()) for m in diagnosis.mismatch},
            )  # fmt: skip
            caption = _COMPARED.format(swim=swim.name)
            blocks.append(series_block(panels, f"{swim.name}: measured and simulated", caption))
    if diagnosis.next_experiment is not None:
        blocks.append(Text(diagnosis.next_experiment.statement, heading="What to record next"))
    unlikely = [effect for effect in diagnosis.effects if effect not in likely]
    considered: list[NamedEffect | Rival] = [*unlikely, *diagnosis.rivals]
    others = [(e.effect, e.component, percent(e.probability)) for e in considered]
    if others:
        blocks.append(Table(("considered as well", "of", "probability"), others))
    lead = "Which physics of the body or the camera does the simulator leave out of these swims?"
    return Section("Diagnosis", lead, [*blocks, *(Text(line) for line in diagnosis.gate)])


def swims_scene(
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    swims: Sequence[Swim],
    simulate: SwimSimulator | None,
    robot: Robot,
) -> Scene:
    """The recordings, and simulated swims of the plain and the enriched model from their start."""
    scene = sum((recorded(recording, robot) for recording in recordings), start=Scene())
    if simulate is None or diagnosis.baseline is None:
        return scene
    models = {"plain": diagnosis.baseline, "enriched": diagnosis.model}
    for recording, swim in zip(recordings, swims, strict=True):
        tracks = simulate(list(models.values()), swim)
        since_start = recording.t - recording.t[0]
        places = [recording.joints.index(joint.name) for joint in robot.joints]
        for name, track in zip(models, tracks, strict=True):
            values = np.column_stack([np.interp(since_start, swim.t, column) for column in track.T])
            position = np.full_like(recording.position, np.nan)
            position[:, places] = values[:, 3:]
            columns = dict(zip(POSE, values[:, :3].T, strict=True))
            scene += recorded(replace(recording, position=position, columns=columns), robot, name)
    return scene
