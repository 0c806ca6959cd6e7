"""Effects of the body and the camera in a model file.

They are listed under ``body.effects``; an effect of a material names it as ``component``. The
effects are defined in ``sim2real.effects.body`` and ``sim2real.effects.camera``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim2real.effects import BODY, CAMERA
from sim2real.effects.body_effect import BodyEffect, CameraEffect
from sim2real.errors import InputError
from sim2real.model import Model

__all__ = ["BODY", "CAMERA", "body_effect", "listed", "values"]


def body_effect(name: str, where: str = "body.effects") -> BodyEffect | CameraEffect:
    """The effect with this identifier.

    Raises:
        InputError: If there is none; ``where`` is the place in the message.
    """
    every: tuple[BodyEffect | CameraEffect, ...] = (*BODY, *CAMERA)
    for effect in every:
        if effect.name == name:
            return effect
    names = ", ".join(effect.name for effect in every)
    raise InputError(where, "effects", repr(name), f"one of {names}")


def values(model: Model, where: str = "model") -> dict[str, float]:
    """Parameters of the effects of body and camera by ``effect.parameter``.

    Parameters of a material are named ``effect.material.parameter``.

    Raises:
        InputError: If an effect or a parameter does not exist, or a value is not a number.
    """
    out: dict[str, float] = {}
    listed: list[Mapping[str, Any]] = list(model.body.get("effects", ()))
    for entry in listed:
        effect = body_effect(str(entry.get("effect")), where)
        names = {parameter.name for parameter in effect.parameters}
        prefix = effect.name
        if effect.by_material:
            prefix += f".{entry.get('component', '')}"
        for name, value in dict(entry.get("parameters", {})).items():
            field = f"body.effects {effect.name}.{name}"
            if name not in names:
                raise InputError(where, field, "no such parameter", " or ".join(sorted(names)))
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(where, field, repr(value), "a number")
            out[f"{prefix}.{name}"] = float(value)
    return out


def listed(parameters: Mapping[str, float]) -> list[dict[str, Any]]:
    """Entries of ``body.effects`` from parameters by name, the inverse of ``values``."""
    entries: dict[str, dict[str, Any]] = {}
    for name, value in parameters.items():
        *prefix, parameter = name.split(".")
        effect = body_effect(prefix[0])
        entry: dict[str, Any] = {"effect": effect.name}
        if effect.by_material and len(prefix) > 1 and prefix[1]:
            entry["component"] = prefix[1]
        entry["parameters"] = {}
        entries.setdefault(".".join(prefix), entry)["parameters"][parameter] = value
    return list(entries.values())
