"""Export of the identified actuators as JSON, for simulators without an exporter."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from sim2real.exporters.actuator import Actuator, Export, LeftOut, actuators, shared_left_out
from sim2real.model import Model
from sim2real.output import finite_json
from sim2real.robot import Robot

SCHEMA = "sim2real.actuators/1"

LAW = (
    "torque = clip(kp (command(t - latency) - position) - kd velocity, -limit, limit)"
    " - back_emf velocity"
)


def actuators_json(
    model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()
) -> Export:
    """JSON with all identified parameters of the joints, and the law as a formula.

    Args:
        model: The fitted model.
        robot: Source of limits and data sheets.
        dropped: Parts that were dropped from the model, to be listed; usually none.

    Raises:
        InputError: See `actuators`.
    """
    lines = (*dropped, *shared_left_out(model))
    content = {
        "schema": SCHEMA,
        "law": LAW,
        "joints": {servo.joint: _content(servo) for servo in actuators(model, robot)},
        "not_expressed": [str(line) for line in lines],
    }
    return Export(json.dumps(finite_json(content), indent=2, allow_nan=False) + "\n", lines)


def _content(servo: Actuator) -> dict[str, Any]:
    content: dict[str, Any] = {
        "kp_Nm_per_rad": servo.kp,
        "kd_Nms_per_rad": servo.kd,
        "back_emf_Nms_per_rad": servo.back_emf,
        "limit_Nm": servo.limit,
        "latency_s": servo.latency,
        "inertia_kgm2": servo.inertia,
        "gravity_Nm": servo.gravity,
        "per_inertia": servo.per_inertia,
        "motor": dict(servo.motor),
        "effects": [
            {"effect": name, "parameters": dict(values)} for name, values in servo.effects.items()
        ],
    }
    if servo.sheet is not None:
        content["limits_rad"] = list(servo.sheet.limits_rad)
        sheet = vars(servo.sheet.servo)
        content["data_sheet"] = {name: sheet[name] for name in sheet if name != "where"}
    return content
