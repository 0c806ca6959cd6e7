"""Parameters of the robots of a batch, one row per robot: masses, servos, and rows of ``Chain``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.robot.chain import Chain, fill
from sim.robot.effects import Outside, about
from sim.robot.shape import Hull
from sim2real.arrays import Array, Index, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import CELLS, TRAIN_ROTORS, beyond_load, joint_row
from sim2real.servo.rollout import active_effects

Rows = dict[str, NDArray[Any]]
"""Values of fields of a Warp struct for some robots, by name."""


@dataclass(frozen=True)
class Masses:
    """Masses of the links; shape (E, L) or (L,), SI."""

    mass: Array  # mass in kg
    inertia: Array  # moment of inertia about the centre of mass in kg m2
    com: Array  # distance of the centre of mass from the link's front end in m


def chain_rows(masses: Masses, servos: Array, outside: Outside) -> Rows:
    """Rows of ``Chain`` that are the same in the fluid and the twin; ``servos`` is (E, J, P)."""
    E, J, columns = servos.shape
    L = J + 1
    com = np.broadcast_to(masses.com + outside["com"], (E, L))
    side = np.broadcast_to(outside["side"], (E, L))
    most = outside["point"].shape[-2]
    point = np.array(np.broadcast_to(outside["point"], (E, L, most, 4)))
    point[..., 0] = com[..., None] - point[..., 0]
    point[..., 1] -= side[..., None]
    shapes = {"rough": (E, L), "skin": (E, J, 4), "coupling": (E,), "tether": (E, 3)}
    shapes |= {"current": (E, 2), "trim": (E, J)}
    return {
        "com": com,
        "side": side,
        "point": point,
        "laden": about(np.broadcast_to(outside["laden"], (E, L, 3, 3)), -com, side),
        **{k: np.broadcast_to(outside[k], shape) for k, shape in shapes.items()},
        "servo": servos,
        "active": active_effects(np.ascontiguousarray(servos).reshape(-1, columns)).reshape(E, J),
    }


def make_chain(rows: Rows, length: Array, limits: Array, device: Any) -> Any:  # noqa: ANN401
    """Parameters of robots on a device, from their rows, the links' lengths and joints' limits."""
    E, J = rows["active"].shape
    ends = np.asarray(limits, dtype=np.float64).reshape(J, 2)
    more = {"length": length, "limits": ends, "memory": (E, J, CELLS), "push": (E, 3 + J)}
    return fill(Chain(), device, **rows, **more)


def change_rows(struct: Any, rows: Mapping[str, Any], which: Index | Mask) -> None:  # noqa: ANN401
    """Overwrite the rows of some robots, in place: captured graphs stay valid."""
    for name, values in rows.items():
        array = getattr(struct, name)
        content = array.numpy()
        content[which] = values
        array.assign(content)


def masses(robot: Robot, models: Sequence[Model], hull: Hull) -> Masses:
    """Masses of the links, by the model's normalised densities where it has them.

    A normalised density is (m_i / l_i) (sum l / sum m): Lin, Liu, Wang (2024), Sec. III-B.1. An
    inertia that the file lacks is that of an elliptic cylinder.
    """
    length, width, nominal = np.array(
        [(link.length_m, link.width_m, link.mass_kg) for link in robot.links]
    ).T
    mass = np.tile(nominal, (len(models), 1))
    for row, model in zip(mass, models, strict=True):
        density = model.body.get("normalised_density")
        if density is not None:
            if len(density) != len(row):
                found, expected = f"{len(density)} values", f"{len(row)}, one for each link"
                raise InputError("model", "body.normalised_density", found, expected)
            row[:] = np.asarray(density) * sum(nominal) * length / length.sum()
    com = [link.length_m / 2 if link.com_m is None else link.com_m for link in robot.links]
    com[0] -= hull.half_width[0, 0]  # the hull's first axis begins behind the nose
    inertia = mass * (length**2 / 12 + width**2 / 16)
    for k, link in enumerate(robot.links):
        if link.inertia_kgm2 is not None:
            inertia[:, k] = link.inertia_kgm2 * mass[:, k] / nominal[k]
    return Masses(mass, inertia, np.broadcast_to(com, mass.shape))


def servo_rows(robot: Robot, models: Sequence[Model]) -> Array:
    """Rows of the servo law's parameters, shape (E, J, P), of models with all joints' gains."""
    rows = []
    for model in models:
        for joint in robot.joints:
            if joint.name not in model.joints:
                known = ", ".join(model.joints) or "none"
                raise InputError("model", "joints", known, f"the robot's joint {joint.name}")
            servo = model.joints[joint.name]
            if servo.per_inertia:
                found = "gains per unit of inertia"
                expected = "gains in N m, from recordings that state their loads"
                raise InputError("model", f"joints.{joint.name}", found, expected)
            row = joint_row(servo, None, joint.name, alone=False)
            row[4] = 0.0  # no pendulum in the water
            if row[list(TRAIN_ROTORS)].any():  # the terms of a gear train know one inertia
                row[3] += beyond_load(row)
            rows.append(row)
    return np.array(rows).reshape(len(models), len(robot.joints), -1)
