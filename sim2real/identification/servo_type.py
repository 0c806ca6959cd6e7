"""Priors of servo types, learned from recordings of other servos of the type.

A type is a file in ``types``, or a user's file, that ``robot.toml`` names::

    [servos.hip]
    type = "xl330"      # or a path that ends in .json

For each parameter of the motor's law it has the mean and the standard deviation of servos of the
type, of the logarithm if that is searched. They are estimated by ``learn`` from fits of several
recordings or servos, by a meta-analysis with random effects (DerSimonian and Laird, Controlled
Clinical Trials 7 (1986) 177-188). Gains are settings and not part of the type.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.motor_prior import MotorPrior
from sim2real.identification.uncertainty import uncertainty
from sim2real.output import write_json
from sim2real.robot import Servo
from sim2real.servo.parameters import LINE, LOOP, MOTOR
from sim2real.structured import Fields, read_json

SCHEMA = "sim2real.servo_type/1"
FOLDER = Path(__file__).parent / "types"

_BETWEEN_LOG = 0.1
"""Smallest standard deviation of a logarithm between servos of one type: a usual tolerance."""
_BETWEEN_SHARE, _BETWEEN_LEAST = 0.3, 0.1
"""The same for other parameters, as a share of the value plus a share of the natural unit."""


@dataclass(frozen=True)
class ServoType:
    """Prior of the motors of one type of servo.

    Attributes:
        name: Its name.
        per_inertia: Whether the loads were unknown, so that torques and inertias are per kg m2 of
            the load; these apply only to servos for which the same is true, or not true.
        parameters: Mean and standard deviation by column of the law, as searched.
        source: Description of the fitted recordings.
    """

    name: str
    per_inertia: bool
    parameters: Mapping[str, tuple[float, float]]
    source: str = ""

    def prior(self, generic: MotorPrior, *, per_inertia: bool) -> MotorPrior:
        """The generic prior, with the parameters of the type where they apply."""
        parameters = []
        for p in generic.parameters:
            applies = per_inertia == self.per_inertia or not p.name.endswith(("_Nm", "_kgm2"))
            if applies and p.name in self.parameters:
                middle, sd = self.parameters[p.name]
                low, high = p.low, p.high
                if p.log:
                    low = min(low, float(np.exp(middle - 4 * sd)))
                    high = max(high, float(np.exp(middle + 4 * sd)))
                p = replace(p, nominal=middle, prior_sd=sd, low=low, high=high)
            parameters.append(p)
        return replace(generic, parameters=tuple(parameters))


def learn(name: str, motors: Sequence[MotorFit], source: str, *, per_inertia: bool) -> ServoType:
    """Learn a type from fits of motors, one or more of each servo.

    Args:
        name: The type's name.
        motors: Fits; a parameter that is fixed in one of them is learned from the others.
        source: Description of the fitted recordings.
        per_inertia: Whether the loads were unknown.
    """
    by_name: dict[str, list[tuple[float, float, float, bool]]] = {}
    for motor in motors:
        spread = uncertainty(motor.fit, motor.units).sd
        values = motor.fit.values
        middles = motor.x[list(motor.problem.free)]
        for k, p in enumerate(motor.fit.parameters):
            if p.name not in MOTOR or p.name in LOOP:
                continue
            if p.name == LINE[1] and motor.law != "motor":
                continue  # no property of the motor where its current is limited
            sd = float(spread[k] / values[k] if p.log else spread[k])
            row = float(middles[k]), min(max(sd, 1e-6), p.prior_sd), p.typical, p.log
            by_name.setdefault(p.name, []).append(row)
    parameters = {name: _pooled(np.array(rows, dtype=np.float64)) for name, rows in by_name.items()}
    return ServoType(name, per_inertia, parameters, source)


def _pooled(rows: Array) -> tuple[float, float]:
    """Predictive mean and standard deviation from rows of value, sd, unit, and whether log."""
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
    """Read the type with this name in ``types``, or in the file with this path.

    Raises:
        InputError: If there is none, or its file does not conform to the format.
    """
    path = Path(name) if name.endswith(".json") else FOLDER / f"{name}.json"
    if not path.is_file():
        available = ", ".join(sorted(p.stem for p in FOLDER.glob("*.json")))
        raise InputError(where, field, repr(name), f"one of {available}, or a file *.json")
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
