"""Layout of the row of parameters of one joint, as rollouts take it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import CATALOGUE, named
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Law
from sim2real.recording import PER_INERTIA, Load

_STIFFEST_RAD_S = 2.5e4
"""Fastest resonance, 4 kHz; stiffer springs are unstable with the shortest sub-step."""
BASE = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s", "inertia_kgm2", "gravity_Nm")
"""Columns of the plain PD servo; ``gravity_Nm`` is the pendulum's torque held level."""
GAINS = BASE[:2]

LINE = ("motor.stall_torque_Nm", "motor.no_load_speed_rad_s")
"""A motor's torque-speed line."""
CURRENT_LIMIT = "torque_saturation.limit_Nm"
"""Largest torque of the motor at any speed, where its current is limited below that at stall."""
RATE_LIMIT = "rate_limit.limit_rad_s"
"""Largest speed of set-points inside the servo."""
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
"""Losses of motor and gears."""
SOFT = ("motor.stick_time_s", "motor.creep_time_s")
"""Time constants with which dry friction stops the shaft."""
LOOP = ("motor.loop_period_s", "motor.loop_phase_s")
"""Sampling times of a sampled controller."""
MOTOR = (*LINE, LOSSES[0], ROTOR, *LOSSES[1:], *SOFT, *LOOP)
"""Columns of the motor's law, see ``motor.py``; all are 0 for a plain PD servo."""

FIRST_MOTOR_COLUMN = len(BASE)
FIRST_EFFECT_COLUMN = len(BASE) + len(MOTOR)
FIRST_COLUMN: Mapping[str, int] = {
    effect.name: FIRST_EFFECT_COLUMN + sum(len(e.parameters) for e in CATALOGUE[:k])
    for k, effect in enumerate(CATALOGUE)
}
"""Column of each effect's first parameter."""
FIRST_CELL: Mapping[str, int] = {
    effect.name: sum(e.memory for e in CATALOGUE[:k]) for k, effect in enumerate(CATALOGUE)
}
"""First memory cell of each effect."""
HELD_CELL = sum(effect.memory for effect in CATALOGUE)
"""Memory cell of the drive that a sampled controller holds."""
LOAD_CELL = HELD_CELL + 1
"""Memory cell of the torque of a load that varies with time."""
CELLS = LOAD_CELL + 1  # of one joint

COLUMNS = (
    *BASE,
    *MOTOR,
    *(f"{e.name}.{parameter.name}" for e in CATALOGUE for parameter in e.parameters),
)
"""Names of all columns of one joint."""
INERTIA_LEFT_OUT = COLUMNS.index("unmodelled_inertia.inertia_kgm2")
"""Column of the inertia in addition to that of the stated load."""
ROTOR_INERTIA = COLUMNS.index(ROTOR)
"""Column of the inertia of rotor and gears."""
LINE_COLUMNS = np.array([COLUMNS.index(name) for name in LINE])
"""Columns of a motor's line: stall torque, no-load speed."""
TRAINS = ("backlash", "compliance")
"""Effects that make two masses of a gear train."""
CONTROL_SIDE = "control_on_output"
"""Their parameter that is 1 where the controller sees the output, 0 where it sees the motor."""
TRAIN_ROTORS = tuple(COLUMNS.index(f"{effect}.rotor_inertia_kgm2") for effect in TRAINS)
"""Columns of the same where it moves by itself; the first that is not 0 counts."""


def beyond_load(rows: Array) -> Array:
    """Inertia on the shaft beyond that of the stated load in kg m2, (..., P) to (...).

    That of rotor and gears, and what ``unmodelled_inertia`` adds.
    """
    first, second = (rows[..., column] for column in TRAIN_ROTORS)
    train = np.where(first != 0, first, second)
    return np.asarray(rows[..., ROTOR_INERTIA] + rows[..., INERTIA_LEFT_OUT] + train)


def joint_row(
    joint: JointModel, load: Load | None, where: str = "model", *, alone: bool = True
) -> Array:
    """The parameter row of a fitted joint, shape (len(COLUMNS),).

    The load is by default that of the model, and ignored if that is per unit of inertia. ``where``
    is the joint's name, for messages; ``alone``: whether it is simulated with the inertia of its
    row, not that of a body.

    Raises:
        InputError: If the model has an effect or a parameter that the catalogue lacks, a parameter
            is negative that cannot be, or the joint is stiffer than any servo.
    """
    row = np.zeros(len(COLUMNS))
    row[:4] = joint.kp_Nm_per_rad, joint.kd_Nms_per_rad, joint.latency_s, joint.inertia_kgm2
    load = load or joint.load
    if load is not None and not joint.per_inertia:
        row[BASE.index("inertia_kgm2")] = load.inertia_kgm2
        row[BASE.index("gravity_Nm")] = load.gravity_Nm
    for name, value in joint.motor.items():
        column = f"motor.{name}"
        if column not in MOTOR:
            valid = ", ".join(column.removeprefix("motor.") for column in MOTOR)
            raise InputError(where, "motor", repr(name), f"one of {valid}")
        row[COLUMNS.index(column)] = value
    for fitted in joint.effects:
        effect = named(fitted.effect, where)
        names = [parameter.name for parameter in effect.parameters]
        for name, value in fitted.parameters.items():
            if name not in names:
                raise InputError(where, fitted.effect, repr(name), f"one of {', '.join(names)}")
            if value < 0 <= effect.parameters[names.index(name)].low:
                field = f"{fitted.effect}.{name}"
                raise InputError(where, field, f"{value:g}", "a number of at least 0")
            row[FIRST_COLUMN[effect.name] + names.index(name)] = value
    inertia = row[BASE.index("inertia_kgm2")] + row[INERTIA_LEFT_OUT] + row[ROTOR_INERTIA]
    if alone and not inertia > 0:
        found = f"{inertia:g} kg m2 with rotor and unmodelled inertia"
        raise InputError(where, "inertia_kgm2", found, "more than 0")
    if alone and row[0] > _STIFFEST_RAD_S**2 * inertia:
        found = f"{row[0]:g} N m/rad on {inertia:g} kg m2, {(row[0] / inertia) ** 0.5:.3g} rad/s"
        expected = f"a resonance of at most {_STIFFEST_RAD_S:g} rad/s"
        raise InputError(where, "kp_Nm_per_rad", found, expected)
    return row


def stated(
    row: Array, load: Load, effects: Sequence[FittedEffect] = (), law: Law | None = None
) -> JointModel:
    """The model of a fitted joint, the inverse of ``joint_row``; effects are as given.

    The load is ``PER_INERTIA`` where none was known. The law is by default the motor's if the row
    has a motor, else the linear one.
    """
    motor, unknown = motor_of(row), load is PER_INERTIA
    kp, kd, latency = (float(x) for x in row[:3])
    own, known = law or ("motor" if motor else "pd"), None if unknown else load
    servo = JointModel(kp, kd, latency, load.inertia_kgm2, unknown, own, motor, known)
    return replace(servo, effects=tuple(effects))


def context_factors(supply_ratio: float, gain_ratio: float) -> Array:
    """Factors on all columns by another supply voltage and another gain of the firmware, (P,).

    The firmware sets the duty cycle of the bridge, so that gain, stall torque and no-load speed are
    proportional to the supply voltage, and damping by back-EMF is not (the circuit of a DC motor).
    """
    factors = np.ones(len(COLUMNS))
    factors[[0, *LINE_COLUMNS]] = supply_ratio
    factors[0] *= gain_ratio
    return factors


def in_context(
    joint: JointModel, *, supply_ratio: float, gain_ratio: float, sample_delay_s: float
) -> JointModel:
    """The joint in the context of a recording: at its supply voltage and gain of the firmware.

    Both are relative to those of the fit. Its latency is relative to the times at which angles are
    sampled, ``sample_delay_s`` after a recording's ``t``.
    """
    factors = dict(zip(COLUMNS, context_factors(supply_ratio, gain_ratio), strict=True))
    return replace(
        joint,
        kp_Nm_per_rad=joint.kp_Nm_per_rad * float(factors["kp_Nm_per_rad"]),
        latency_s=joint.latency_s - sample_delay_s,
        motor={  # unknown names are reported by ``joint_row``
            name: x * float(factors.get(f"motor.{name}", 1.0)) for name, x in joint.motor.items()
        },
    )


def motor_of(row: Array) -> dict[str, float]:
    """Motor parameters of a row (P,) by name, without those that have no effect."""
    values = row[FIRST_MOTOR_COLUMN : FIRST_MOTOR_COLUMN + len(MOTOR)]
    pairs = zip(MOTOR, values, strict=True)
    return {name.removeprefix("motor."): float(value) for name, value in pairs if value > 0}
