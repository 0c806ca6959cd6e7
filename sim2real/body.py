"""The catalogue's rows for the body in the water and for the camera above it.

Their equations stand where they act: the body's in ``sim.robot.outside`` and ``sim.twin.twin``, the
camera's in ``sim2real.camera``. A model lists those it has under ``body.effects``; one that belongs
to a material names it as ``component``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sim2real.errors import InputError
from sim2real.model import Model


@dataclass(frozen=True)
class BodyParameter:
    """One parameter.

    Attributes:
        name: As in a model file.
        unit: SI; empty for a pure number.
        typical: A size that matters; the step of a fit and the scale of its prior.
        low, high: The range that means anything.
    """

    name: str
    unit: str
    typical: float
    low: float
    high: float


@dataclass(frozen=True)
class BodyEffect:
    """Physics of the body or the camera that a plain simulator leaves out.

    Attributes:
        name: Its identifier.
        title: What it is, as a roboticist would say.
        parameters: All 0 where it is off.
        camera: Whether it belongs to the camera.
        by_material: Whether each material has its own.
    """

    name: str
    title: str
    parameters: tuple[BodyParameter, ...]
    camera: bool = False
    by_material: bool = False


_P = BodyParameter

BODY: tuple[BodyEffect, ...] = (
    BodyEffect(
        "skin_elasticity",
        "the skin over the joints is a spring that pulls them straight",
        (_P("stiffness_Nm_per_rad", "N m/rad", 0.3, 0.0, 10.0),),
    ),
    BodyEffect(
        "skin_damping",
        "the skin over the joints resists their motion",
        (_P("damping_Nms_per_rad", "N m s/rad", 0.03, 0.0, 2.0),),
    ),
    BodyEffect(
        "skin_viscoelasticity",
        "the skin over the joints is a spring that gives way with time",
        (
            _P("stiffness_Nm_per_rad", "N m/rad", 0.3, 0.0, 10.0),
            _P("relaxation_s", "s", 0.3, 0.02, 5.0),
        ),
    ),
    BodyEffect(
        "skin_coupling",
        "the skin pulls neighbouring joints to the same angle",
        (_P("stiffness_Nm_per_rad", "N m/rad", 0.2, 0.0, 5.0),),
    ),
    BodyEffect(
        "linear_drag",
        "resistance that grows with the speed of the body",
        (_P("coefficient", "N s/m", 0.3, -5.0, 20.0),),
    ),
    BodyEffect(
        "surface_friction",
        "the surface is rougher than thought: friction along it with the square of the speed",
        (_P("coefficient", "", 0.01, -0.1, 0.3),),
        by_material=True,
    ),
    BodyEffect(
        "form_drag",
        "the body's shape resists more than thought, with the square of the speed",
        (_P("coefficient", "", 0.1, -1.0, 3.0),),
    ),
    BodyEffect(
        "added_mass",
        "more water goes along with the body sideways; a share of what it displaces",
        (_P("ratio", "", 0.2, -0.5, 2.0),),
    ),
    BodyEffect(
        "pool_current",
        "the pool's water moves evenly",
        (_P("u_m_s", "m/s", 0.02, -0.5, 0.5), _P("v_m_s", "m/s", 0.02, -0.5, 0.5)),
    ),
    BodyEffect(
        "tether",
        "a cable pulls the head to a place in the pool",
        (
            _P("stiffness_N_per_m", "N/m", 0.1, 0.0, 10.0),
            _P("x_m", "m", 0.5, -10.0, 10.0),
            _P("y_m", "m", 0.5, -10.0, 10.0),
        ),
    ),
    BodyEffect(
        "wall_effect",
        "near a wall the robot swims faster, by this share one body length away from it",
        (_P("ratio", "", 0.1, 0.0, 2.0),),
    ),
    BodyEffect(
        "com_offset",
        "the centre of mass is not where the file says, forwards and to the left",
        (_P("x_m", "m", 0.01, -0.1, 0.1), _P("y_m", "m", 0.005, -0.05, 0.05)),
    ),
    BodyEffect(
        "trim_asymmetry",
        "the joints' zero is off by an angle, to the same side",
        (_P("offset_rad", "rad", 0.03, -0.5, 0.5),),
    ),
)

CAMERA: tuple[BodyEffect, ...] = (
    BodyEffect(
        "camera_latency",
        "the camera's poses are late",
        (_P("latency_s", "s", 0.05, -0.05, 0.5),),
        camera=True,
    ),
    BodyEffect(
        "camera_scale",
        "the camera's metres are too long or too short by this share",
        (_P("ratio", "", 0.02, -0.3, 0.3),),
        camera=True,
    ),
    BodyEffect(
        "camera_rotation",
        "the camera's axes are turned against the pool's, but not its headings",
        (_P("angle_rad", "rad", 0.03, -0.8, 0.8),),
        camera=True,
    ),
    BodyEffect(
        "marker_offset",
        "the marker sits off the head's centre of mass, forwards and to the left",
        (_P("x_m", "m", 0.02, -0.3, 0.3), _P("y_m", "m", 0.02, -0.1, 0.1)),
        camera=True,
    ),
    BodyEffect(
        "pose_filter",
        "the poses are smoothed by a first-order low-pass",
        (_P("time_constant_s", "s", 0.05, 0.0, 1.0),),
        camera=True,
    ),
    BodyEffect(
        "dropped_frames",
        "some frames are lost and the last pose is repeated",
        (_P("probability", "", 0.05, 0.0, 0.4),),
        camera=True,
    ),
)


def body_effect(name: str, where: str = "body.effects") -> BodyEffect:
    """The effect with this identifier.

    Raises:
        InputError: If there is none; ``where`` says who asked.
    """
    for effect in BODY + CAMERA:
        if effect.name == name:
            return effect
    known = ", ".join(effect.name for effect in BODY + CAMERA)
    raise InputError(where, "effects", repr(name), f"one of {known}")


def values(model: Model, where: str = "model") -> dict[str, float]:
    """Parameters of the body's and the camera's effects by ``effect.parameter``.

    One that belongs to a material is called ``effect.material.parameter``.

    Raises:
        InputError: If an effect or a parameter does not exist, or is no finite number.
    """
    out: dict[str, float] = {}
    listed: list[Mapping[str, Any]] = list(model.body.get("effects", ()))
    for entry in listed:
        effect = body_effect(str(entry.get("effect")), where)
        known = {parameter.name for parameter in effect.parameters}
        prefix = effect.name
        if effect.by_material:
            prefix += f".{entry.get('component', '')}"
        for name, value in dict(entry.get("parameters", {})).items():
            field = f"body.effects {effect.name}.{name}"
            if name not in known:
                raise InputError(where, field, "no such parameter", " or ".join(sorted(known)))
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
