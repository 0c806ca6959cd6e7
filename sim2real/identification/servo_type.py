"""What recordings of other servos of a type have told: the prior of the next one.

A type is a file of ``types``, or one of one's own, which ``robot.toml`` names::

    [servos.hip]
    type = "xl330"      # or a path that ends in .json

For each parameter of the motor's law it has the middle and the spread that a servo of the type is
expected to have: of the logarithm where the law searches that. Learned by ``learn`` from fits of
several recordings or servos, as in a meta-analysis with random effects (DerSimonian and Laird,
Controlled Clinical Trials 7 (1986) 177-188). Gains are settings, not of the type.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.motor_prior import MotorPrior, ParameterPrior
from sim2real.identification.uncertainty import uncertainty
from sim2real.output import write_json
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, LOOP
from sim2real.structured import Fields, read_json

Array = NDArray[np.float64]

SCHEMA = "sim2real.servo_type/1"
FOLDER = Path(__file__).parent / "types"

_BETWEEN_LOG = 0.1
"""Least spread between servos of one type, of a logarithm: what makers promise of motors."""
_BETWEEN_SHARE, _BETWEEN_LEAST = 0.3, 0.1
"""The same of what is searched as it is, as a share of its value and of its step that matters."""


@dataclass(frozen=True)
class ServoType:
    """Prior of the motors of one type of servo.

    Attributes:
        name: Its name.
        per_inertia: Whether the loads that it was learned from were unknown: torques and inertias
            are then per kg m2 of them, and say nothing of a load that is known, nor these of one
            that is not.
        parameters: Mean and standard deviation by column of the law, as searched.
        source: What it was learned from.
    """

    name: str
    per_inertia: bool
    parameters: Mapping[str, tuple[float, float]]
    source: str = ""

    def prior(self, generic: MotorPrior, *, per_inertia: bool) -> MotorPrior:
        """The generic prior with what is known of the type in its place."""
        told = {
            name: parameter
            for name, parameter in self.parameters.items()
            if per_inertia == self.per_inertia or not name.endswith(("_Nm", "_kgm2"))
        }
        parameters = tuple(_typed(p, told.get(p.name)) for p in generic.parameters)
        return replace(generic, parameters=parameters)


def _typed(parameter: ParameterPrior, known: tuple[float, float] | None) -> ParameterPrior:
    if known is None:
        return parameter
    middle, sd = known
    low, high = parameter.low, parameter.high
    if parameter.log:
        low = min(low, float(np.exp(middle - 4 * sd)))
        high = max(high, float(np.exp(middle + 4 * sd)))
    return replace(parameter, middle=middle, sd=sd, low=low, high=high)


def learn(name: str, motors: Sequence[MotorFit], source: str, *, per_inertia: bool) -> ServoType:
    """The type of servos whose motors were fitted, one or more of each.

    Args:
        name: The type's name.
        motors: Fits; a parameter that one of them held is learned from the others.
        source: What they were fitted to.
        per_inertia: Whether the loads were unknown.
    """
    seen: dict[str, list[tuple[float, float, float, bool]]] = {}
    for motor in motors:
        spread = uncertainty(motor.fit, motor.units).sd
        values = motor.fit.values
        for k, place in enumerate(motor.problem.free):
            parameter = motor.problem.prior.parameters[place]
            if parameter.name in BASE or parameter.name in LOOP:
                continue
            sd = float(spread[k] / values[k] if parameter.log else spread[k])
            sd = min(max(sd, 1e-6), parameter.sd)
            row = float(motor.x[place]), sd, parameter.unit, parameter.log
            seen.setdefault(parameter.name, []).append(row)
    parameters = {name: _together(np.array(rows, dtype=np.float64)) for name, rows in seen.items()}
    return ServoType(name, per_inertia, parameters, source)


def _together(rows: Array) -> tuple[float, float]:
    """Middle and spread of the next servo from rows of value, spread, unit, and whether log."""
    value, sd, unit, log = rows.T
    weight = sd**-2
    mean = float(weight @ value / weight.sum())
    excess = float(weight @ (value - mean) ** 2) - (value.size - 1)
    scale = float(weight.sum() - (weight**2).sum() / weight.sum())
    between = np.sqrt(max(excess / scale, 0.0)) if scale > 0 else 0.0
    least = _BETWEEN_LOG if log[0] else _BETWEEN_SHARE * abs(mean) + _BETWEEN_LEAST * unit[0]
    between = max(between, float(least))
    weight = 1 / (sd**2 + between**2)
    middle = float(weight @ value / weight.sum())
    return middle, float(np.sqrt(between**2 + 1 / weight.sum()))


def read_type(name: str, where: str = "robot", field: str = "type") -> ServoType:
    """The type of this name among those that ship, or of the file at this path.

    Raises:
        InputError: If there is none, or its file is not as written.
    """
    path = Path(name) if name.endswith(".json") else FOLDER / f"{name}.json"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in FOLDER.glob("*.json")))
        raise InputError(where, field, repr(name), f"one of {known}, or a file *.json")
    content = read_json(path, SCHEMA)
    table = Fields(path, "", content).table("parameters")
    parameters = {}
    for key in table.content:
        entry = table.table(key)
        parameters[f"motor.{key}"] = entry.number("middle"), entry.number("sd", above=0)
    return ServoType(
        str(content.get("name", path.stem)),
        content.get("per_inertia") is True,
        parameters,
        str(content.get("source", "")),
    )


def type_of(servo: Servo) -> ServoType | None:
    """The type that a servo's table in ``robot.toml`` names; None where it names none."""
    file, table = servo.where
    return read_type(servo.type, file, f"{table}.type") if servo.type else None


def write_type(servo_type: ServoType, path: Path) -> None:
    """Write the file that ``read_type`` reads."""
    parameters = {
        name.removeprefix("motor."): {"middle": round(middle, 4), "sd": round(sd, 4)}
        for name, (middle, sd) in servo_type.parameters.items()
    }
    write_json(
        path,
        {
            "schema": SCHEMA,
            "name": servo_type.name,
            "per_inertia": servo_type.per_inertia,
            "source": servo_type.source,
            "parameters": parameters,
        },
    )
