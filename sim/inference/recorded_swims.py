"""Diagnosis of recorded swims: choice of the simulator, and the file of the fluid's simulations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from sim.inference.coordinates import SwimSimulator
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.in_water import (
    VARIANTS,
    InWater,
    key,
    read_water_swims,
    resimulation,
    robot_in_water,
    simulate_in_water,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import IN_WATER, LAW_ERROR, LawError, read_law_error
from sim.inference.swims import Swim, swim_of
from sim2real.diagnose.result import Diagnosis
from sim2real.diagnose.rival_sets import design_of, separations
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.output import check_writable, provenance
from sim2real.progress import progress_bar
from sim2real.recording import Recording
from sim2real.robot import Robot

Resimulate = Callable[[Model], tuple[SwimSimulator, Model] | None]
"""A function from a fitted model to a simulator corrected with it, see ``diagnose_swims``."""
THREADS = 2
"""CPU threads of the fluid."""


def diagnose_recorded_swims(
    recordings: Sequence[Recording],
    model: Model,
    robot: Robot,
    *,
    references: Sequence[Recording] = (),
    in_water: Path | None = None,
    device: str = "cpu",
) -> Diagnosis:
    """Diagnose swims in the twin or, with ``in_water``, relative to the fluid.

    Args:
        recordings: Pool recordings of one robot in one pool.
        model: The servos.
        robot: The robot.
        references: Swims of the same robot in which nothing is known to be missing.
        in_water: File of the fluid's simulations; they are made where it does not exist.
        device: Warp device of the fluid. On a GPU the fluid simulates the swims again with the
            effects that the first search found.

    Raises:
        InputError: If the file holds the simulations of other swims.
    """
    swims = [swim_of(recording, robot) for recording in recordings]
    earlier = [swim_of(recording, robot) for recording in references]
    law_error: LawError = LAW_ERROR
    resimulate: Resimulate = _no_resimulation
    if in_water is not None:
        water = _simulated_in_water(in_water, robot, model, [*swims, *earlier], device)
        law_error = read_law_error(IN_WATER)
        if device != "cpu":
            water_model = water.of(model)
            resimulate = resimulation(
                robot, water_model, swims, water, device=device, threads=THREADS
            )
    start, simulate = robot_in_water(robot, model, [in_water] if in_water else [])
    with progress_bar("diagnose") as progress:
        diagnosis = diagnose_swims(
            swims,
            start,
            robot,
            simulate,
            references=earlier,
            law_error=law_error,
            resimulate=resimulate,
            progress=progress,
        )
    # the search draws nothing at random, so that there is no seed
    origin = provenance([*recordings, *references, in_water, robot, model], None)
    return replace(_compared(diagnosis, recordings), provenance=origin)


def _compared(diagnosis: Diagnosis, recordings: Sequence[Recording]) -> Diagnosis:
    """The diagnosis with what designed recordings were expected to tell, and what they showed."""
    rivals = diagnosis.swim_rivals
    assert rivals is not None
    found = {one.effects: one.probability for one in rivals.sets}
    stated = design_of(recordings, rivals.component)
    return replace(diagnosis, separations=separations(rivals.component, stated, found))


def simulator_of(
    robot: Robot, model: Model, in_water: Path | None = None, device: str = "cpu"
) -> SwimSimulator | None:
    """The simulator of a diagnosis, for plots; None where the fluid was simulated again."""
    if in_water is not None and device != "cpu":
        return None
    return robot_in_water(robot, model, [in_water] if in_water else [])[1]


def _no_resimulation(fitted: Model) -> tuple[SwimSimulator, Model] | None:
    return None


def _simulated_in_water(
    path: Path, robot: Robot, model: Model, swims: Sequence[Swim], device: str
) -> InWater:
    """The fluid's simulations of these swims, made where there is no such file."""
    if not path.exists():
        check_writable(path)
        print(f"the fluid simulates {len(swims)} swims with {1 + len(VARIANTS)} sets of settings")
        simulations = simulate_in_water(robot, model, swims, device=device, threads=THREADS)
        write_water(path, with_nearest_law(robot, model, simulations))
    water = read_water_swims(path)
    for swim in swims:
        if key(swim) not in water.steps:
            found = f"no simulation of the commands of {swim.name}"
            raise InputError(path, "commands", found, "one of every swim")
    return water
