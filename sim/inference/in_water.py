"""Swims that the fluid has swum, beside which the twin says only what changes.

The twin is a force law and some three noises of a camera away from a robot; the fluid is one or
two, and slow. So the fluid swims what was sent to the robot once, as the bench has it, and the
twin is asked for differences alone: of an effect, of a gain (a control variate; Peherstorfer,
Willcox and Gunzburger, SIAM Rev. 60 (2018) 550). What cells of one size, one viscosity and one
sub-grid constant get wrong, one friction line and one size of box, is a difference too: the fluid
swims with others as well, and how far a robot's water lies along each is fitted
(``water.viscosity`` and so on), as a gain is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.calibration.emulator import path_of, steps_of
from sim.fluid.wall import SLIP, Wall
from sim.inference.coordinates import WATER, Coordinates, Swum
from sim.inference.followed import by_followed_twin
from sim.inference.searched import learned
from sim.inference.swims import Swim, with_values
from sim.inference.twin_search import TwinSwims
from sim.robot.swimmer import CONTROL_S, SMAGORINSKY, Swimmer
from sim.twin.law import Coefficients
from sim2real.body import values
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.velocity import body_velocity

Array = NDArray[np.float64]

CELL_M = 0.016
"""Side of a cell."""
BOX_M = (1.25, 0.9, 0.4)
"""Length, width and depth of a box, which goes with its robot."""
VISCOSITY_M2_S = 5e-5
"""Away from the wall: what such cells bear."""
SUBSTEPS = 20
"""Steps of the lattice in a control period: with half as many a servo lags by another 5 %."""
COARSE = 1.25
"""Side of a cell of the other waters, over that of the first."""
VARIANTS: Mapping[str, Mapping[str, Any]] = dict(
    zip(
        WATER,
        ({}, {"viscosity": 2.5}, {"smagorinsky": 0.75}, {"line": "laminar"}, {"box": 0.85}),
        strict=True,
    )
)
"""Other waters, in larger cells: their viscosity, sub-grid constant and box over those of the
first, and the friction line of a boundary layer that stays laminar: where it turns nobody knows."""

SWUM = (
    "skin_", "linear_drag", "surface_friction", "form_drag", "added_mass", "com_offset",
    "trim_asymmetry",
)  # fmt: skip
"""Effects with which the fluid swims again: those that act wherever a robot is."""


@dataclass(frozen=True)
class InWater:
    """What the fluid swam.

    Attributes:
        names: What may be otherwise of the water, V of them.
        steps: Of each swim, by ``key``: ways forward, to the left (m/s) and round (rad/s) in each
            period and the joints' angles, shape (1 + V, T - 1, 3 + J): of the first water, and how
            far each of the others is from it, but for ``cells`` from that in larger cells.
        law: Coefficients of the twin that is nearest to them, where that was fitted.
    """

    names: tuple[str, ...]
    steps: Mapping[bytes, Array]
    law: Mapping[str, float] = field(default_factory=dict)

    def of(self, model: Model) -> Model:
        """The model with the twin's law that is nearest, and with shares of the other waters."""
        body = {**model.body, "water": dict.fromkeys(self.names, 0.0)}
        return replace(model, body=body | ({"twin": dict(self.law)} if self.law else {}))


def key(swim: Swim) -> bytes:
    """What is kept of a swim: its commands, and the heading in which it began."""
    heading = np.float32(np.round(swim.start[2], 2))
    return swim.command.astype(np.float32).tobytes() + heading.tobytes()


def swum_in_water(
    robot: Robot,
    model: Model | Sequence[Model],
    swims: Sequence[Swim],
    *,
    cell_m: float = CELL_M,
    device: str = "cpu",
    variants: Mapping[str, Mapping[str, Any]] = VARIANTS,
    box_m: tuple[float, float, float] = BOX_M,
    threads: int = 1,
) -> InWater:
    """Let the fluid swim what was sent in each swim, all at once.

    Args:
        robot: The robot.
        model: Its servos, as a bench has them; one for all swims, or one for each.
        swims: Whose commands are sent, from where they began: speed in a box of cells depends on
            the heading by some percent. Else their recordings are not looked at.
        cell_m: Side of a cell.
        device: Warp device.
        variants: Other waters.
        box_m: Size of a box.
        threads: CPU threads.
    """
    longest = max((swim.command for swim in swims), key=len)
    rows = [np.pad(s.command, ((0, len(longest) - len(s.command)), (0, 0)), "edge") for s in swims]
    sent = np.stack(rows, axis=1)
    waters = []
    for side, given in ((1.0, {}), *((COARSE, one) for one in variants.values())):
        swimmer = Swimmer(
            robot, model, n_envs=len(swims), cell_m=side * cell_m, device=device,
            box_m=tuple(given.get("box", 1.0) * side_m for side_m in box_m),
            viscosity_m2_s=VISCOSITY_M2_S * given.get("viscosity", 1.0),
            smagorinsky=SMAGORINSKY * given.get("smagorinsky", 1.0), threads=threads,
            substeps=SUBSTEPS, wall=Wall(slip=True, line=given.get("line", SLIP.line)),
        )  # fmt: skip
        swimmer.reset(pose=np.array([swim.start for swim in swims]))
        track = []
        for row in [None, *sent[:-1]]:
            if row is not None:
                swimmer.step(row)
            state = swimmer.state()
            track.append(np.concatenate([state.pose, state.measured], axis=1))
        waters.append(steps_of(np.moveaxis(np.array(track), 0, 1)))
    every = np.stack(waters, axis=1)
    every[..., :3] /= CONTROL_S
    every[:, 2:] -= every[:, 1:2]
    every[:, 1:2] -= every[:, :1]
    known = {key(s): every[k, :, : len(s.t) - 1] for k, s in enumerate(swims)}
    return InWater(tuple(variants), known)


def beside(model: Model, found: Model) -> Model:
    """The model with what was found that the fluid can swim with: all but places and the camera."""
    there = {name: v for name, v in values(found).items() if name.startswith(SWUM)}
    return with_values(replace(model, joints=found.joints), there)


def swum_again(
    robot: Robot,
    models: Sequence[Model],
    swims: Sequence[Swim],
    water: InWater,
    **given: Any,  # noqa: ANN401
) -> InWater:
    """The swims with what was found in each: a strong effect makes another swim of it.

    Args:
        robot: The robot.
        models: Of each swim, as ``beside`` has them.
        swims: Whose commands are sent.
        water: What the fluid swam before; how far other waters are from it stays.
        given: As ``swum_in_water`` takes it.
    """
    again = swum_in_water(robot, models, swims, variants={}, **given).steps
    steps = {k: np.concatenate([one[:1], water.steps[k][1:]]) for k, one in again.items()}
    return replace(water, steps=steps)


def swims_again(
    robot: Robot,
    model: Model,
    swims: Sequence[Swim],
    water: InWater,
    **given: Any,  # noqa: ANN401
) -> Callable[[Model], tuple[Swum, Model] | None]:
    """From what was found to a simulator beside it, and with what: None if there is nothing to add.

    Args:
        robot: The robot.
        model: As ``InWater.of`` has it.
        swims: Whose commands are sent.
        water: What the fluid swam before.
        given: As ``swum_in_water`` takes it.
    """

    def beside_it(found: Model) -> tuple[Swum, Model] | None:
        there = beside(model, found)
        if not values(there):
            return None
        again = swum_again(robot, [there] * len(swims), swims, water, **given)
        return by_twin_in_water(robot, there, again), there

    return beside_it


def with_nearest_law(robot: Robot, model: Model, water: InWater, **given: Any) -> InWater:  # noqa: ANN401, D417
    """The same with the law of the twin that is nearest to what the fluid swam.

    Args:
        robot: The robot.
        model: Its servos, with which the fluid swam.
        water: What it swam; the first two swims are looked at.
    """
    swims = []
    for number, (sent, steps) in enumerate(list(water.steps.items())[:2]):
        rows = np.frombuffer(sent, np.float32)[:-1].reshape(-1, len(robot.joints))
        command = rows.astype(np.float64)
        ways = steps[:1].copy()
        ways[..., :3] *= CONTROL_S
        track = path_of(ways, np.zeros(3), np.zeros(len(robot.joints)))[0]
        t: Array = CONTROL_S * np.arange(len(command), dtype=np.float64)
        signals = np.concatenate([body_velocity(t, track[:, :3]), track[:, 3:]], axis=1)
        swims.append(Swim(f"water {number}", t, command, np.zeros(3), signals, pose=track[:, :3]))
    problem = TwinSwims(
        Coordinates.of(robot, model), swims, by_followed_twin(robot, **given),
        learned([], model, robot, by_followed_twin(robot)),
    )  # fmt: skip
    found = problem.coordinates.parameters(problem.plain().fit.x)
    law = vars(Coefficients.of(model.body)) | {
        name.removeprefix("twin."): v for name, v in found.items() if name.startswith("twin.")
    }
    return replace(water, law=law)


def by_twin_in_water(robot: Robot, model: Model, water: InWater, **given: Any) -> Swum:  # noqa: ANN401, D417
    """The twin (options ``given``), put right by the fluid where it has swum.

    Args:
        robot: The robot.
        model: That the fluid swam with; its ``body.twin`` should be the law nearest to the fluid.
        water: What the fluid swam.
    """
    twin = by_followed_twin(robot, **given)
    begun: dict[bytes, Array] = {}

    def run(models: Sequence[Model], swim: Swim) -> Array:
        known = water.steps.get(key(swim))
        still = [repr(replace(one, body={**one.body, "water": None})) for one in models]
        _, first, which = np.unique(still, return_index=True, return_inverse=True)
        track = twin([models[k] for k in first], swim)[which]
        if known is None and swim.pose is None:
            return track  # a swim that is only planned
        if known is None:
            raise KeyError(f"{swim.name}: the fluid has not swum these commands")
        at = key(swim) + swim.start.tobytes()
        if at not in begun:
            begun[at] = steps_of(twin([model], swim))[0]
        fluid = known.copy()
        fluid[..., :3] *= CONTROL_S
        share = np.array([
            [one.body.get("water", {}).get(name, 0.0) for name in water.names] for one in models
        ])  # fmt: skip
        steps = steps_of(track) + (fluid[0] - begun[at])
        steps += np.einsum("ev,vtk->etk", share, fluid[1:])
        return path_of(steps, swim.start, track[:, 0, 3:])

    return run


def robot_in_water(
    robot: Robot,
    model: Model,
    files: Sequence[Path],
    **given: Any,  # noqa: ANN401
) -> tuple[Model, Swum]:
    """A model and a simulator for swims that the fluid has swum; without files, the twin alone.

    Args:
        robot: The robot.
        model: Its servos, with which the fluid swam.
        files: Of ``write_water``; the law is that of the first.
        given: Options of the twin.
    """
    if not files:
        return model, by_followed_twin(robot, **given)
    parts = [read_water_swims(path) for path in files]
    steps = {sent: known for part in parts for sent, known in part.steps.items()}
    water = replace(parts[0], steps=steps)
    model = water.of(model)
    return model, by_twin_in_water(robot, model, water, **given)


def write_water(path: Path, water: InWater) -> None:
    """Keep what the fluid swam, in half precision."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {
        "names": np.array(water.names), "law_names": np.array(list(water.law)),
        "law": np.array(list(water.law.values())),
    }  # fmt: skip
    for k, (sent, steps) in enumerate(water.steps.items()):
        arrays[f"steps_{k}"] = steps.astype(np.float16)
        arrays[f"key_{k}"] = np.frombuffer(sent, np.float32)
    np.savez_compressed(path, **arrays)


def read_water_swims(path: Path) -> InWater:
    """What ``write_water`` kept.

    Raises:
        InputError: If it is no such file.
    """
    try:
        kept = np.load(path)
        names = tuple(kept["names"].tolist())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(path, "content", "no swims in water", "a file by --in-water") from error
    count = sum(name.startswith("key_") for name in kept.files)
    steps = {
        kept[f"key_{k}"].tobytes(): kept[f"steps_{k}"].astype(np.float64) for k in range(count)
    }
    law = dict(zip(kept["law_names"].tolist(), kept["law"].tolist(), strict=True))
    return InWater(names, steps, law)


__all__ = [
    "InWater", "beside", "by_twin_in_water", "read_water_swims", "robot_in_water", "swims_again",
    "swum_again", "swum_in_water", "with_nearest_law", "write_water",
]  # fmt: skip
