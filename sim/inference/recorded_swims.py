"""Recordings of swims diagnosed: simulators chosen, the fluid's simulations kept in a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from sim.inference.coordinates import Swum
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.in_water import (
    VARIANTS,
    InWater,
    key,
    read_water_swims,
    robot_in_water,
    swims_again,
    swum_in_water,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import IN_WATER, LAW_ERROR, LawError, read_law_error
from sim.inference.swims import Swim, swim_of
from sim2real.diagnose.result import Diagnosis
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.output import check_writable, provenance_of
from sim2real.progress import progress_bar
from sim2real.recording import Recording
from sim2real.robot import Robot

Again = Callable[[Model], tuple[Swum, Model] | None]
"""From a first search to a simulator around what it found, see ``diagnose_swims``."""
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
        references: Swims of the same robot in which nothing is thought to be missing.
        in_water: File of the fluid's simulations; they are made where it does not exist.
        device: Warp device of the fluid. On a GPU the fluid simulates the swims again with the
            effects that the first search found.

    Raises:
        InputError: If the file holds the simulations of other swims.
    """
    swims = [swim_of(recording, robot) for recording in recordings]
    earlier = [swim_of(recording, robot) for recording in references]
    known: LawError = LAW_ERROR
    again: Again = _not_again
    if in_water is not None:
        water = _simulated_in_water(in_water, robot, model, [*swims, *earlier], device)
        known = read_law_error(IN_WATER)
        if device != "cpu":
            started = water.of(model)
            again = swims_again(robot, started, swims, water, device=device, threads=THREADS)
    start, simulate = robot_in_water(robot, model, [in_water] if in_water else [])
    with progress_bar("diagnose") as progress:
        found = diagnose_swims(
            swims,
            start,
            robot,
            simulate,
            references=earlier,
            known=known,
            again=again,
            progress=progress,
        )
    # the search draws nothing at random, so that there is no seed
    inputs = [*recordings, *references, in_water, robot, model]
    return replace(found, provenance=provenance_of(inputs, None))


def simulator_of(
    robot: Robot, model: Model, in_water: Path | None = None, device: str = "cpu"
) -> Swum | None:
    """The simulator of a diagnosis, to draw what it found; None where the fluid swam again."""
    if in_water is not None and device != "cpu":
        return None
    return robot_in_water(robot, model, [in_water] if in_water else [])[1]


def _not_again(found: Model) -> tuple[Swum, Model] | None:
    return None


def _simulated_in_water(
    path: Path, robot: Robot, model: Model, swims: Sequence[Swim], device: str
) -> InWater:
    """The fluid's simulations of these swims, made where there is no such file."""
    if not path.exists():
        check_writable(path)
        print(f"the fluid simulates {len(swims)} swims with {1 + len(VARIANTS)} sets of settings")
        made = swum_in_water(robot, model, swims, device=device, threads=THREADS)
        write_water(path, with_nearest_law(robot, model, made))
    water = read_water_swims(path)
    for swim in swims:
        if key(swim) not in water.steps:
            found = f"no simulation of the commands of {swim.name}"
            raise InputError(path, "commands", found, "one of every swim")
    return water


__all__ = ["diagnose_recorded_swims", "simulator_of"]
