"""Parameters of swims: the twin's law, servos, water, effects of the body and the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim.robot.effects import area_sd
from sim.robot.swimmer import least_viscosity
from sim.twin.law import FITTED, Coefficients
from sim2real.body import body_effect
from sim2real.effects import BODY, CAMERA
from sim2real.effects.body_effect import BodyEffect, CameraEffect
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.robot import Robot

Name = tuple[str, str]
"""An effect of body or camera, and the material that it belongs to, or ``body`` or ``camera``."""
Names = frozenset[Name]
SERVO = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
AREAS = "appendage_area"
"""Error of what the robot file states, which a calibration fits: no physics that it leaves out."""
_CALIBRATED = ("across", "along", "added_mass", "linear", "thrust", "wake", "wake_s")
"""Coefficients of the law that a calibration fits: a few swims do not distinguish the others from
these, and they could conceal a missing effect."""
_USUAL = {"across": 1.0, "along": 0.2, "added_mass": 0.2, "linear": 0.2}
"""Least usual values of coefficients, for those whose fitted values are smaller."""
_LAW_SD = {"thrust": 0.5, "wake": 0.3, "wake_s": FITTED.wake_s}
_HIGHEST = {"thrust": 2.0, "wake": 0.95, "wake_s": 10.0}
"""Prior standard deviations and upper bounds that are not multiples of the usual value."""


def law_parameters(
    law: Coefficients = FITTED, names: Sequence[str] = _CALIBRATED
) -> list[Parameter]:
    """Coefficients of the twin's law, about those of ``law``."""
    out = []
    for name in names:
        value = float(getattr(law, name))
        size = max(abs(value), 0.1)
        usual = max(size, _USUAL.get(name, 0.0))
        high, sd = _HIGHEST.get(name, 20 * usual), _LAW_SD.get(name, 2 * usual)
        low = 0.05 if name == "wake_s" else 0.0
        out.append(Parameter(f"twin.{name}", low, high, 0.4 * size, value, sd))
    return out


def servo_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Latencies of all joints, which a radio link changes, and their gains if asked."""
    out = []
    for joint in robot.joints:
        servo = model.joints[joint.name]
        for name in SERVO if gains else SERVO[2:]:
            value = float(getattr(servo, name))
            size = max(abs(value), 1e-3)
            sd = (0.5 if name == "latency_s" else 0.1) * size
            bounds = (0.1 * size, 5 * size)
            out.append(Parameter(f"{joint.name}.{name}", *bounds, 0.2 * size, value, sd))
    return out


def twin_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Parameters of a calibration in the twin: its law, the appendages' areas, the servos."""
    servos = servo_parameters(model, robot, gains=gains)
    return [*law_parameters(), *appendage_parameters(robot), *servos]


def appendage_parameters(robot: Robot) -> list[Parameter]:
    """The error of the drag areas of the appendages in the robot file; none without appendages."""
    if not robot.appendages:
        return []
    (ratio,) = effect_parameters(AREAS)
    return [replace(ratio, prior_sd=max(area_sd(robot), ratio.typical / 10))]


def effect_parameters(effect: str, material: str | None = None) -> list[Parameter]:
    """Parameters of a body or camera effect."""
    described = body_effect(effect)
    prefix = f"{effect}.{material}" if described.by_material else effect
    out = []
    for k, p in enumerate(described.parameters):
        start = max(0.0 if k == 0 or p.low < 0 else p.typical, p.low)
        name, sd = f"{prefix}.{p.name}", 4 * p.typical
        out.append(Parameter(name, p.low, p.high, p.typical, start, sd, unit=p.unit))
    return out


def water_parameters(robot: Robot, cell_m: float) -> list[Parameter]:
    """Drag, friction and added mass of the body, and the viscosity for cells of a size."""
    out = effect_parameters("form_drag") + effect_parameters("linear_drag")
    for material in _materials(robot):
        out += effect_parameters("surface_friction", material)
    out += appendage_parameters(robot) + effect_parameters("added_mass")
    least = least_viscosity(cell_m)
    bounds = (least, 20 * least)
    viscosity = ("water.viscosity_m2_s", *bounds, 0.4 * least, 1.2 * least, 0.6 * least)
    return [*out, Parameter(*viscosity)]


def candidates(robot: Robot) -> dict[Name, list[Parameter]]:
    """Every effect of the catalogue's body and camera that this robot may have."""
    out = {}
    effects: tuple[BodyEffect | CameraEffect, ...] = (*BODY, *CAMERA)
    for effect in effects:
        if effect.name == AREAS:
            continue
        component = "camera" if isinstance(effect, CameraEffect) else "body"
        for material in _materials(robot) if effect.by_material else [None]:
            free = effect_parameters(effect.name, material)
            out[effect.name, material or component] = free
    return out


def _materials(robot: Robot) -> list[str]:
    return sorted({link.material or "" for link in robot.links})
