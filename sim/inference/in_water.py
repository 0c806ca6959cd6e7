"""Simulations of swims in the fluid, and what they say of other parameters.

For a diagnosis the fluid simulates the recorded commands once, with the identified servos, and the
twin predicts only differences (a control variate; Peherstorfer, Willcox and Gunzburger, SIAM Rev.
60 (2018) 550), also with other settings. For a calibration an ``emulator`` is linear.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from sim.fluid.wall import SLIP
from sim.inference.coordinates import SERVO_EFFECTS, Coordinates
from sim.inference.law_error import learned
from sim.inference.swim_problem import SwimProblem
from sim.inference.swims import (
    FLUID_THREADS,
    Swim,
    SwimSimulator,
    by_followed_twin,
    distinct,
    path_of,
    steps_of,
    swum,
    values_of,
    with_values,
)
from sim.robot.swimmer import CONTROL_S, SMAGORINSKY, Swimmer
from sim.twin.law import Coefficients
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter, column
from sim2real.model import JointModel, Model
from sim2real.output import check_writable, write_whole
from sim2real.robot import Robot
from sim2real.structured import read_arrays
from sim2real.velocity import body_velocity

CELL_M = 0.012
"""Side of a cell."""
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "cells": {},
    "viscosity": {"viscosity": 2.5},
    "eddies": {"smagorinsky": 0.75},
    "friction": {"line": "laminar"},
    "box": {"box": 0.85},
}
"""Variants of the fluid (``coordinates.WATER``), in larger cells: settings relative to those of the
first simulation, and the friction line of a laminar boundary layer."""
RESIMULATED = (
    "skin_", "linear_drag", "surface_friction", "form_drag", "added_mass", "com_offset",
    "trim_asymmetry", "appendage_",
)  # fmt: skip
"""Effects with which the fluid is simulated again: those that do not depend on the position."""


@dataclass(frozen=True)
class InWater:
    """Simulations of swims in the fluid."""

    names: tuple[str, ...]  # names of the V variants of the fluid
    # for each swim, by ``key``: mean velocity forward, to the left (m/s) and of the heading (rad/s)
    # in each period, and the joints' angles, shape (1 + V, T - 1, 3 + J): the first simulation,
    # then the differences of ``cells`` from it, and of the other variants from ``cells``
    steps: Mapping[bytes, Array]
    law: Mapping[str, float] = field(default_factory=dict)  # of the twin fitted to these, if any

    def of(self, model: Model) -> Model:
        """The model with the fitted law of the twin, and with shares of the variants, all 0."""
        body = {**model.body, "water": dict.fromkeys(self.names, 0.0)}
        return replace(model, body=body | ({"twin": dict(self.law)} if self.law else {}))


def key(swim: Swim) -> bytes:
    """Identifier of a swim: its commands and its initial heading."""
    heading = np.float32(np.round(swim.start[2], 2))
    return swim.command.astype(np.float32).tobytes() + heading.tobytes()


def simulate_in_water(
    robot: Robot,
    model: Model | Sequence[Model],
    swims: Sequence[Swim],
    *,
    cell_m: float = CELL_M,
    device: str = "cpu",
    variants: Mapping[str, Mapping[str, Any]] = VARIANTS,
    threads: int = 1,
) -> InWater:
    """Simulate commands of swims from their first poses in one batch; a model for all or each.

    The viscosity is about the smallest that is stable in the larger cells of the variants. Each box
    moves with its robot.
    """
    longest = max(len(swim.command) for swim in swims)
    padded = [np.pad(s.command, ((0, longest - len(s.command)), (0, 0)), "edge") for s in swims]
    starts = np.array([swim.start for swim in swims])
    waters = []
    for side, settings in ((1.0, {}), *((1.25, variant) for variant in variants.values())):
        swimmer = Swimmer(
            robot, model, n_envs=len(swims), cell_m=side * cell_m, device=device,
            box_m=tuple(settings.get("box", 1.0) * side_m for side_m in (1.25, 0.9, 0.4)),
            viscosity_m2_s=5e-5 * settings.get("viscosity", 1.0),
            smagorinsky=SMAGORINSKY * settings.get("smagorinsky", 1.0), threads=threads,
            wall=replace(SLIP, line=settings.get("line", SLIP.line)),
        )  # fmt: skip
        waters.append(steps_of(swum(swimmer, np.stack(padded, axis=1), starts)))
    simulated = np.stack(waters, axis=1)
    simulated[..., :3] /= CONTROL_S
    simulated[:, 2:] -= simulated[:, 1:2]
    simulated[:, 1:2] -= simulated[:, :1]
    steps = {key(s): simulated[k, :, : len(s.t) - 1] for k, s in enumerate(swims)}
    return InWater(tuple(variants), steps)


def with_fluid_effects(model: Model, fitted: Model) -> Model:
    """The model with the servos of a fitted model and its effects that are in ``RESIMULATED``."""
    effects = {name: v for name, v in values(fitted).items() if name.startswith(RESIMULATED)}
    return with_values(replace(model, joints=fitted.joints), effects)


def differs(model: Model, fitted: Model) -> bool:
    """Whether a gain (by 5 %), latency (3 ms), friction (0.01 N m) or effect is another one."""

    def quantities(servo: JointModel) -> Array:
        gains = np.log([servo.kp_Nm_per_rad, servo.kd_Nms_per_rad]) / 0.05
        friction = [e.parameters["torque_Nm"] for e in servo.effects if e.effect in SERVO_EFFECTS]
        return np.append(gains, [servo.latency_s / 0.003, sum(friction) / 0.01])

    pairs = ((servo, fitted.joints[name]) for name, servo in model.joints.items())
    apart = [np.abs(quantities(other) - quantities(servo)).max() for servo, other in pairs]
    return bool(values(fitted)) or max(apart) > 1.0


def simulate_again(
    robot: Robot, models: Sequence[Model], swims: Sequence[Swim], water: InWater,
    **options: Any,  # noqa: ANN401
) -> InWater:  # fmt: skip
    """Simulate swims with the effects found in each; variants differ as those of ``water``."""
    again = simulate_in_water(robot, models, swims, variants={}, **options).steps
    steps = {k: np.concatenate([first[:1], water.steps[k][1:]]) for k, first in again.items()}
    return replace(water, steps=steps)


def resimulated(
    robot: Robot,
    model: Model,
    swims: Sequence[Swim],
    water: InWater,
    fitted: Model,
    **options: Any,  # noqa: ANN401
) -> tuple[SwimSimulator, Model] | None:
    """The simulator corrected by simulations with a fitted model's effects, or None."""
    with_effects = with_fluid_effects(model, fitted)
    if not differs(model, with_effects):
        return None
    again = simulate_again(robot, [with_effects] * len(swims), swims, water, **options)
    return by_twin_in_water(robot, with_effects, again), with_effects


def with_nearest_law(robot: Robot, model: Model, water: InWater, **options: Any) -> InWater:  # noqa: ANN401
    """The simulations with coefficients of the law of a twin fitted to two."""
    swims, joints = [], len(robot.joints)
    for number, (identifier, steps) in enumerate(list(water.steps.items())[:2]):
        command = np.frombuffer(identifier, np.float32)[:-1].reshape(-1, joints).astype(np.float64)
        (track,) = path_of(_displacements(steps[:1]), np.zeros(3), np.zeros(joints))
        t: Array = CONTROL_S * np.arange(len(command), dtype=np.float64)
        signals = np.concatenate([body_velocity(t, track[:, :3]), track[:, 3:]], axis=1)
        swims.append(Swim(f"water {number}", t, command, np.zeros(3), signals, track[:, :3]))
    twin = by_followed_twin(robot, **options)
    coordinates, prior = Coordinates.of(robot, model), learned([], model, robot, twin)
    problem = SwimProblem(coordinates, swims, twin, prior)
    fitted = problem.coordinates.model_at(problem.plain().fit.x)
    return replace(water, law=vars(Coefficients.of(fitted.body)))


def _displacements(velocities: Array) -> Array:
    """``InWater.steps`` as ``steps_of``."""
    return np.concatenate([velocities[..., :3] * CONTROL_S, velocities[..., 3:]], axis=-1)


def by_twin_in_water(robot: Robot, model: Model, water: InWater, **options: Any) -> SwimSimulator:  # noqa: ANN401
    """The twin, corrected by simulations of a model in the fluid, to which its law was fitted."""
    twin = by_followed_twin(robot, **options)
    of_twin: dict[bytes, Array] = {}

    def run(models: Sequence[Model], swim: Swim) -> Array:
        unique, place = distinct([replace(m, body={**m.body, "water": None}) for m in models])
        track = twin(unique, swim)[place]
        if key(swim) not in water.steps:
            raise KeyError(f"{swim.name}: no simulation of these commands in the fluid")
        start = key(swim) + swim.start.tobytes()
        if start not in of_twin:
            of_twin[start] = steps_of(twin([model], swim))[0]
        fluid = _displacements(water.steps[key(swim)])
        shares = [[m.body.get("water", {}).get(name, 0.0) for name in water.names] for m in models]
        steps = steps_of(track) + (fluid[0] - of_twin[start])
        steps += np.einsum("ev,vtk->etk", shares, fluid[1:])
        return path_of(steps, swim.start, track[:, 0, 3:])

    return run


def emulator(
    simulator: SwimSimulator,
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    *,
    count: int,
    seed: int = 0,
) -> SwimSimulator:
    """A simulator of these swims that is linear near a model in the parameters that are ``free``.

    The wake is turbulent, and differences of two rollouts would be noise: all are varied at once in
    ``count`` rollouts (a Sobol sequence: Santner, Williams, Notz, The Design and Analysis of
    Computer Experiments, Springer 2003), and the displacements in every control period regressed on
    them, with a penalty of the slopes as large as the weight of one rollout.
    """
    if count < len(free) + 2:
        expected = f"at least {len(free) + 2}, for {len(free)} parameters"
        raise InputError("emulator", "rollouts", str(count), expected)
    names = [p.name for p in free]
    centre, reach = values_of(model, names), 0.75 * column(free, "typical")
    low = np.maximum(centre - reach, column(free, "low"))
    high = np.minimum(low + 2 * reach, column(free, "high"))
    shares = qmc.Sobol(len(free), rng=seed).random_base2((count - 1).bit_length())
    drawn = np.concatenate([centre[None], low + (high - low) * shares[: count - 1]])
    models = [with_values(model, dict(zip(names, row, strict=True))) for row in drawn]
    by_log = np.array([name == "water.viscosity_m2_s" for name in names])

    def linear(rows: Array) -> Array:
        """Parameters in which a rollout is nearly linear."""
        return np.where(by_log, np.log(np.where(by_log, rows, 1.0)), rows)

    mean, size = linear(drawn).mean(axis=0), np.maximum(linear(drawn).std(axis=0), 1e-12)

    def terms(rows: Array) -> Array:
        return np.concatenate([np.ones((len(rows), 1)), (linear(rows) - mean) / size], axis=1)

    penalty = np.diag([0.0, *np.ones(len(free))])
    regressed = {}
    for swim in swims:
        track = simulator(models, swim)
        finite = np.asarray(np.isfinite(track).all(axis=(1, 2)))
        if finite.mean() < 0.5:
            found = f"{np.sum(~finite)} of {finite.size} rollouts stopped"
            raise InputError(swim.name, "simulator", found, "most of them whole")
        steps, x = steps_of(track[finite]), terms(drawn[finite])
        flat = np.linalg.solve(x.T @ x + penalty, x.T @ steps.reshape(len(steps), -1))
        regressed[swim] = flat.reshape(-1, *steps.shape[1:]), track[finite][0, 0, 3:]

    def simulate(models: Sequence[Model], swim: Swim) -> Array:
        weights, angles = regressed[swim]
        rows = np.array([values_of(model, names) for model in models])
        return path_of(np.tensordot(terms(rows), weights, axes=1), swim.start, angles)

    return simulate


def robot_in_water(
    robot: Robot, model: Model, files: Sequence[Path], **options: Any  # noqa: ANN401
) -> tuple[Model, SwimSimulator]:  # fmt: skip
    """A model and a simulator corrected by ``write_water``'s files; without any the twin."""
    if not files:
        return model, by_followed_twin(robot, **options)
    water = read_water_swims(*files)
    model = water.of(model)
    return model, by_twin_in_water(robot, model, water, **options)


def water_of(path: Path, robot: Robot, model: Model, swims: Sequence[Swim], device: str) -> InWater:
    """The fluid's simulations of these swims in a file, made where there is none."""
    if not path.exists():
        check_writable(path)
        print(f"the fluid simulates {len(swims)} swims with {1 + len(VARIANTS)} sets of settings")
        simulations = simulate_in_water(robot, model, swims, device=device, threads=FLUID_THREADS)
        write_water(path, with_nearest_law(robot, model, simulations))
    water = read_water_swims(path)
    for swim in swims:
        if key(swim) not in water.steps:
            found = f"no simulation of the commands of {swim.name}"
            raise InputError(path, "commands", found, "one of every swim")
    return water


def write_water(path: Path, water: InWater) -> None:
    """Write simulations in the fluid to a file, in half precision."""
    arrays: dict[str, Any] = {
        "names": np.array(water.names), "law_names": np.array(list(water.law)),
        "law": np.array(list(water.law.values())),
    }  # fmt: skip
    for k, (identifier, steps) in enumerate(water.steps.items()):
        arrays[f"steps_{k}"] = steps.astype(np.float16)
        arrays[f"key_{k}"] = np.frombuffer(identifier, np.float32)
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    write_whole(path, stream.getvalue())


def read_water_swims(*paths: Path) -> InWater:
    """Read files by ``write_water``: all their simulations, with the law of the first."""
    steps: dict[bytes, Array] = {}
    first, expected = None, "a file by --in-water"
    for path in paths:
        content = read_arrays(path, expected, what="swims in water")
        try:
            law = dict(zip(content["law_names"].tolist(), content["law"].tolist(), strict=True))
            first = first or InWater(tuple(content["names"].tolist()), steps, law)
            for k in range(sum(name.startswith("key_") for name in content)):
                steps[content[f"key_{k}"].tobytes()] = content[f"steps_{k}"].astype(np.float64)
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(path, "content", "no swims in water", expected) from error
    assert first is not None
    return first
