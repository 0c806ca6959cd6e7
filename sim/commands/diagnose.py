"""``sim2real diagnose``: of servos, or of the body where the recordings are of a pool."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from sim.inference.coordinates import Swum
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.followed import by_followed_twin
from sim.inference.in_water import (
    VARIANTS,
    InWater,
    by_twin_in_water,
    key,
    read_water_swims,
    swims_again,
    swum_in_water,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import IN_WATER, LAW_ERROR, read_law_error
from sim.inference.swims import Swim, swim_of
from sim.view.diagnosis_page import swims_section
from sim2real.commands import diagnose as servos
from sim2real.diagnose.result import write_diagnosis
from sim2real.errors import InputError
from sim2real.model import Model, read_model, write_model
from sim2real.output import check_writable, provenance
from sim2real.recording import read_recording
from sim2real.report.page import write_page
from sim2real.robot import Robot, read_robot


def run(options: argparse.Namespace) -> int:
    """Diagnose the body from swims, the servos from anything else."""
    recordings = [read_recording(path) for path in options.recordings]
    swims = [one for one in recordings if one.kind == "pool" and "body.x_m" in one.columns]
    if not swims:
        return servos.run(options)
    if len(swims) < len(recordings):
        other = next(one for one in recordings if one not in swims)
        where = other.path or other.name
        raise InputError(where, "kind", "a recording of a bench", "swims alone, or servos alone")
    if options.model is None:
        raise InputError("diagnose", "--model", "none", "MODEL.json of the servos, to swim with")
    references = [read_recording(path) for path in options.references or ()]
    out = check_writable(options.out)
    robot, model = read_robot(options.robot), read_model(options.model)
    given = [swim_of(one, robot) for one in swims]
    earlier = [swim_of(one, robot) for one in references]
    simulate, known = by_followed_twin(robot), LAW_ERROR
    again: Callable[[Model], tuple[Swum, Model] | None] = lambda found: None  # noqa: E731
    if options.in_water:
        water = _swum(options, robot, model, [*given, *earlier])
        model, known = water.of(model), read_law_error(IN_WATER)
        simulate = by_twin_in_water(robot, model, water)
        if options.device != "cpu":
            again = swims_again(robot, model, given, water, device=options.device, threads=2)
    with tqdm(total=100, desc="diagnose", unit="%", disable=None) as bar:
        found = diagnose_swims(
            given,
            model,
            robot,
            simulate,
            references=earlier,
            known=known,
            again=again,
            progress=lambda share: bar.update(round(100 * share) - bar.n),
        )
    files = [*options.recordings, *(options.references or ())]
    files += [options.in_water] if options.in_water else []
    inputs = [*files, options.robot, options.model]
    found = replace(found, provenance=provenance(inputs, None))  # nothing is drawn at random
    enriched = out.with_name(f"{out.stem}.enriched.json")
    write_model(found.model, enriched)
    write_diagnosis(found, out, enriched.name)
    print(f"verdict: {found.verdict}")
    for effect in found.effects:
        print(f"  {100 * effect.probability:3.0f} %  {effect.statement}")
    if found.effects:
        before, after = (found.effects[0].heldout[k] for k in ("rmse_before", "rmse_after"))
        print(f"  error of the speed on what was held out: {before:.4f} m/s, now {after:.4f} m/s")
    for rival in found.rivals[:3]:
        print(f"  considered: {rival.effect} ({rival.component}), {100 * rival.probability:.0f} %")
    if not options.no_page:
        title, page = f"Diagnosis of {robot.name}", out.with_suffix(".html")
        many = "1 swim" if len(swims) == 1 else f"{len(swims)} swims"
        subtitle = f"{many}, verdict: {found.verdict.replace('_', ' ')}"
        # only what the search was made with can draw what it found
        elsewhere = options.in_water and options.device != "cpu"
        section = swims_section(found, given, None if elsewhere else simulate, robot)
        write_page(page, title, subtitle, [section], found.provenance)
        print(f"page: {page}")
    return 0


def _swum(
    options: argparse.Namespace, robot: Robot, model: Model, swims: Sequence[Swim]
) -> InWater:
    """What the fluid swam of the commands of these swims; it swims where nothing is kept.

    Raises:
        InputError: If what is kept is of other swims.
    """
    path: Path = options.in_water
    if not path.exists():
        path = check_writable(path)
        print(f"the fluid swims {len(swims)} swims in {1 + len(VARIANTS)} waters")
        made = swum_in_water(robot, model, swims, device=options.device, threads=2)
        write_water(path, with_nearest_law(robot, model, made))
    kept = read_water_swims(path)
    for swim in swims:
        if key(swim) not in kept.steps:
            raise InputError(path, "commands", f"not those of {swim.name}", "what was sent in it")
    return kept
