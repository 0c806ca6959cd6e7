"""Effects of the body and the camera: in a model file, and on measured poses.

A model file lists them under ``body.effects``; an effect of a material names it as ``component``.
They are defined in ``sim2real.effects.body`` and ``sim2real.effects.camera``.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import BODY, CAMERA, find
from sim2real.effects.body_effect import SwimEffect
from sim2real.errors import InputError
from sim2real.model import Model


def body_effect(name: str, where: str = "body.effects") -> SwimEffect:
    """The effect of the body or the camera with this name; InputError if there is none."""
    return find((*BODY, *CAMERA), name, where)


def material_note(effect: str, component: str) -> str:
    """The material in brackets, for an effect with separate parameters for each; else nothing."""
    return f" ({component})" if body_effect(effect).by_material else ""


def values(model: Model, where: str = "model") -> dict[str, float]:
    """Effects of body and camera by ``effect.parameter`` or ``effect.material.parameter``."""
    out: dict[str, float] = {}
    for entry in model.body.get("effects", ()):
        effect = body_effect(str(entry.get("effect")), where)
        names = {parameter.name for parameter in effect.parameters}
        material = f".{entry.get('component', '')}" if effect.by_material else ""
        for name, value in dict(entry.get("parameters", {})).items():
            field = f"body.effects {effect.name}.{name}"
            if name not in names:
                raise InputError(where, field, "no such parameter", " or ".join(sorted(names)))
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(where, field, repr(value), "a number")
            out[f"{effect.name}{material}.{name}"] = float(value)
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


def observed(t: Array, pose: Array, parameters: Mapping[str, float]) -> Array:
    """Poses (T, 3), m and rad, as the camera measures them at ``t`` (T,) in s, evenly spaced."""
    out = np.array(pose, dtype=np.float64)
    for effect in CAMERA:
        values = {p.name: parameters.get(f"{effect.name}.{p.name}", 0.0) for p in effect.parameters}
        if any(values.values()):
            out = effect.see(t, out, values)
    return out
