"""The row of numbers that a rollout takes for each joint: where each parameter stands in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import CATALOGUE, named
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel
from sim2real.recording import PER_INERTIA, Load

BASE = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s", "inertia_kgm2", "gravity_Nm")
"""Columns of the plain PD servo; ``gravity_Nm`` is the pendulum's torque held level."""

LINE = ("motor.stall_torque_Nm", "motor.no_load_speed_rad_s")
"""A motor's torque-speed line: what the recordings may say of its drive."""

ROTOR = "motor.rotor_inertia_kgm2"

LOSSES = (
    "motor.resistance_rise",
    "motor.coulomb_Nm",
    "motor.motor_friction",
    "motor.load_friction",
    "motor.stribeck_motor_friction",
    "motor.stribeck_load_friction",
    "motor.stribeck_speed_rad_s",
)
"""What they may say of its losses and its gears."""

SOFT = ("motor.stick_time_s", "motor.creep_time_s")
"""How softly dry friction stops the shaft."""

LOOP = ("motor.loop_period_s", "motor.loop_phase_s")
"""When a sampled controller looks."""

MOTOR = (*LINE, LOSSES[0], ROTOR, *LOSSES[1:], *SOFT, *LOOP)
"""Columns of the motor's law, see ``motor.py``; all 0, the servo is the plain PD one."""

FIRST_MOTOR_COLUMN = len(BASE)

FIRST_EFFECT_COLUMN = len(BASE) + len(MOTOR)
"""Where the effects' begin."""

FIRST_COLUMN: Mapping[str, int] = {
    effect.name: FIRST_EFFECT_COLUMN + sum(len(e.parameters) for e in CATALOGUE[:k])
    for k, effect in enumerate(CATALOGUE)
}
"""Column of each effect's first parameter."""

FIRST_CELL: Mapping[str, int] = {
    effect.name: sum(e.memory for e in CATALOGUE[:k]) for k, effect in enumerate(CATALOGUE)
}
"""Cell of memory where each effect's begins."""

HELD_CELL = sum(effect.memory for effect in CATALOGUE)
"""Cell of memory with the drive that a sampled loop holds."""

CELLS = HELD_CELL + 1
"""Cells of memory of one joint."""

COLUMNS = (
    BASE
    + MOTOR
    + tuple(
        f"{effect.name}.{parameter.name}" for effect in CATALOGUE for parameter in effect.parameters
    )
)
"""Names of all columns of one joint."""

INERTIA_LEFT_OUT = COLUMNS.index("unmodelled_inertia.inertia_kgm2")
"""Column of the inertia that no load states."""

ROTOR_INERTIA = COLUMNS.index(ROTOR)
"""Column of the inertia of rotor and gears."""

Array = NDArray[np.float64]


def joint_row(joint: JointModel, load: Load | None, where: str = "model") -> Array:
    """The parameter row of a fitted joint, shape (len(COLUMNS),).

    Args:
        joint: The fitted joint.
        load: The load it turns; the model's own where None. Ignored where the model is per unit of
            inertia.
        where: The joint's name, for messages.

    Raises:
        InputError: If the model has an effect or a parameter that the catalogue lacks.
    """
    row = np.zeros(len(COLUMNS))
    row[: len(BASE)] = (
        joint.kp_Nm_per_rad,
        joint.kd_Nms_per_rad,
        joint.latency_s,
        joint.inertia_kgm2,
        0.0,
    )
    load = load or joint.load
    if load is not None and not joint.per_inertia:
        row[BASE.index("inertia_kgm2")] = load.inertia_kgm2
        row[BASE.index("gravity_Nm")] = load.gravity_Nm
    for name, value in joint.motor.items():
        column = f"motor.{name}"
        if column not in MOTOR:
            known = ", ".join(column.removeprefix("motor.") for column in MOTOR)
            raise InputError(where, "motor", repr(name), f"one of {known}")
        row[COLUMNS.index(column)] = value
    for fitted in joint.effects:
        _fill(row, fitted, where)
    return row


def stated(row: Array, load: Load, effects: Sequence[FittedEffect] = ()) -> JointModel:
    """A fitted joint as a model states it: what ``joint_row`` takes back.

    Args:
        row: Its parameters, shape (len(COLUMNS),); what it has of a motor included.
        load: The load that it was fitted with, ``PER_INERTIA`` where none was known.
        effects: Those that it has.
    """
    motor = motor_of(row)
    kp, kd, latency = (float(x) for x in row[:3])
    return JointModel(
        kp,
        kd,
        latency,
        inertia_kgm2=load.inertia_kgm2,
        per_inertia=load is PER_INERTIA,
        law="motor" if motor else "pd",
        motor=motor,
        load=None if load is PER_INERTIA else load,
        effects=tuple(effects),
    )


def motor_of(row: Array) -> dict[str, float]:
    """What a row (P,) has of a motor, by name; parameters that have no effect are left out."""
    values = row[FIRST_MOTOR_COLUMN : FIRST_MOTOR_COLUMN + len(MOTOR)]
    pairs = zip(MOTOR, values, strict=True)
    return {name.removeprefix("motor."): float(value) for name, value in pairs if value > 0}


def _fill(row: Array, fitted: FittedEffect, where: str) -> None:
    effect = named(fitted.effect, where)
    names = [parameter.name for parameter in effect.parameters]
    for name, value in fitted.parameters.items():
        if name not in names:
            raise InputError(where, fitted.effect, repr(name), f"one of {', '.join(names)}")
        row[FIRST_COLUMN[effect.name] + names.index(name)] = value
