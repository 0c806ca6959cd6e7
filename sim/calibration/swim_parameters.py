"""Parameters of swims: the twin's law, servos, water, effects of the body and the camera."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from sim.robot.effects import area_sd
from sim.robot.swimmer import least_viscosity
from sim.twin.twin import FITTED
from sim2real.body import body_effect
from sim2real.effects import BODY, CAMERA
from sim2real.effects.body_effect import BodyEffect, CameraEffect
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.robot import Robot


class Candidate(NamedTuple):
    """An effect of the body or of the camera that a simulator may leave out.

    Attributes:
        name: Its identifier in the catalogue.
        component: The material that it belongs to, or ``body`` or ``camera``.
        free: Its parameters.
    """

    name: str
    component: str
    free: tuple[Parameter, ...]


AREAS = "appendage_area"
"""Error of what the robot file states, which a calibration fits: no physics that it leaves out."""
_LEAST = {"across": 1.0, "along": 0.2, "added_mass": 0.2, "linear": 0.2}
"""Least usual values of coefficients, for those whose fitted values are smaller."""


def law_parameters() -> list[Parameter]:
    """Coefficients of the twin's law, within a small factor of those fitted to the fluid.

    The other coefficients (``slender``, ``head`` and so on) keep the values fitted to the fluid: a
    few swims do not distinguish them from these, and they could conceal a missing effect.
    """
    out = []
    for name, least in _LEAST.items():
        value = float(getattr(FITTED, name))
        usual = max(value, least)
        out.append(
            _about(f"twin.{name}", value, 0.5 * usual, (0.05 * value, 20 * usual), 2 * usual)
        )
    return [
        *out,
        _about("twin.thrust", FITTED.thrust, 0.1, (0.0, 2.0), 0.5),
        _about("twin.wake", FITTED.wake, 0.1, (0.0, 0.95), 0.3),
        _about("twin.wake_s", FITTED.wake_s, 0.3 * FITTED.wake_s, (0.05, 10.0), FITTED.wake_s),
    ]


def servo_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Latencies of all joints, and their gains if asked.

    Gains are determined better on a bench than in a swim, where the added mass conceals them; the
    latency can differ, e.g. with a radio link.
    """
    out = []
    names = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s") if gains else ("latency_s",)
    for joint in robot.joints:
        servo = model.joints[joint.name]
        for name in names:
            value = float(getattr(servo, name))
            size = max(abs(value), 1e-3)
            sd = 0.5 if name == "latency_s" else 0.1
            full = f"{joint.name}.{name}"
            out.append(_about(full, value, 0.2 * size, (0.05 * size, 20 * size), sd * size))
    return out


def twin_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Parameters of a calibration in the twin: its law, the appendages' areas, the servos."""
    servos = servo_parameters(model, robot, gains=gains)
    return [*law_parameters(), *appendage_parameters(robot), *servos]


def body_parameters(robot: Robot) -> list[Parameter]:
    """Parameters of the body for a calibration: drag, friction, added mass and centre of mass."""
    out = effect_parameters("form_drag") + effect_parameters("linear_drag")
    for material in sorted({link.material or "" for link in robot.links}):
        out += effect_parameters("surface_friction", material)
    out += appendage_parameters(robot)
    return out + effect_parameters("added_mass") + effect_parameters("com_offset")


def appendage_parameters(robot: Robot) -> list[Parameter]:
    """The error of the drag areas of the appendages in the robot file; none without appendages.

    Its prior has the standard deviation of the drag coefficients.
    """
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
        start = 0.0 if k == 0 or p.low < 0 else p.typical
        start = max(start, p.low)
        name, sd = f"{prefix}.{p.name}", 4 * p.typical
        out.append(Parameter(name, p.low, p.high, p.typical, start, sd, unit=p.unit))
    return out


def water_parameters(robot: Robot, cell_m: float) -> list[Parameter]:
    """Parameters of the water for cells of a size."""
    free = [p for p in body_parameters(robot) if not p.name.startswith("com_offset")]
    least = least_viscosity(cell_m)
    bounds = (least, 20 * least)
    return [*free, _about("water.viscosity_m2_s", 1.2 * least, 0.4 * least, bounds, 0.6 * least)]


def candidates(robot: Robot) -> list[Candidate]:
    """Every effect of the catalogue's body and camera that this robot may have."""
    out = []
    effects: tuple[BodyEffect | CameraEffect, ...] = (*BODY, *CAMERA)
    for effect in effects:
        if effect.name == AREAS:
            continue
        if effect.by_material:
            for material in sorted({link.material or "" for link in robot.links}):
                free = tuple(effect_parameters(effect.name, material))
                out.append(Candidate(effect.name, material or "body", free))
        else:
            component = "camera" if isinstance(effect, CameraEffect) else "body"
            out.append(Candidate(effect.name, component, tuple(effect_parameters(effect.name))))
    return out


def _about(
    name: str, nominal: float, size: float, bounds: tuple[float, float], prior_sd: float
) -> Parameter:
    return Parameter(name, *bounds, size, nominal, prior_sd)
