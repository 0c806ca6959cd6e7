"""The identified actuators as plain JSON, for simulators that have no exporter here."""

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


def plain(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """JSON with every number that was identified of the joints, and the law in words.

    Args:
        model: The fitted model.
        robot: Gives limits and data sheets, if there is one.
        dropped: What the model had more, for the file to list; nothing is, as a rule.

    Raises:
        InputError: See `actuators`.
    """
    lines = (*dropped, *shared_left_out(model))
    content = {
        "schema": SCHEMA,
        "law": LAW,
        "joints": {one.joint: _content(one) for one in actuators(model, robot)},
        "not_expressed": [str(line) for line in lines],
    }
    return Export(json.dumps(finite_json(content), indent=2, allow_nan=False) + "\n", lines)


def _content(given: Actuator) -> dict[str, Any]:
    content: dict[str, Any] = {
        "kp_Nm_per_rad": given.kp,
        "kd_Nms_per_rad": given.kd,
        "back_emf_Nms_per_rad": given.back_emf,
        "limit_Nm": given.limit,
        "latency_s": given.latency,
        "inertia_kgm2": given.inertia,
        "gravity_Nm": given.gravity,
        "per_inertia": given.per_inertia,
        "motor": dict(given.motor),
        "effects": [
            {"effect": name, "parameters": dict(values)} for name, values in given.effects.items()
        ],
    }
    if given.sheet is not None:
        content["limits_rad"] = list(given.sheet.limits_rad)
        sheet = vars(given.sheet.servo)
        content["data_sheet"] = {name: sheet[name] for name in sheet if name != "where"}
    return content
