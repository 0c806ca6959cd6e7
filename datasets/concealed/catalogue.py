"""The 28 effects of joint, supply and link: how large they are and where they act in the plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from bench import Servo
from numpy.typing import NDArray
from world import World

Array = NDArray[np.float64]
Parameters = dict[str, float]


@dataclass(frozen=True)
class Scale:
    """What the size of an effect is measured by: the servo and its motion with nothing hidden."""

    servo: Servo
    peak_torque_Nm: float
    mean_square_current_A2: float
    least_latency_s: float  # of the three joints


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    Attributes:
        place: ``joint``, ``supply`` or ``link``.
        driver: What decides its size from moment to moment.
        family: Effects of one family are not hidden in one joint together; they share a mechanism.
        draw: Parameters at a strength, 1 being nominal, and a shape: three numbers in 0 to 1.
        hide: Changes a world.
    """

    place: str
    driver: str
    family: str
    draw: Callable[[float, Scale, Array], Parameters]
    hide: Callable[[World, int, Parameters], None]


def _sign(u: float) -> float:
    return 1.0 if u >= 0.5 else -1.0


def _log(low: float, high: float, u: float) -> float:
    return float(low * (high / low) ** u)


def _field(name: str, parameter: str) -> Callable[[World, int, Parameters], None]:
    """An effect that is one field of the plant."""

    def hide(world: World, j: int, p: Parameters) -> None:
        world.joints[name][j] = p[parameter]

    return hide


def _sensor(name: str, parameter: str) -> Callable[[World, int, Parameters], None]:
    """An effect that is one error of the sensor."""

    def hide(world: World, j: int, p: Parameters) -> None:
        world.errors[j][name] = p[parameter]

    return hide


def _stribeck(world: World, j: int, p: Parameters) -> None:
    world.joints["friction_Nm"][j] = p["torque_Nm"]
    world.joints["stiction_Nm"][j] = p["breakaway_Nm"] - p["torque_Nm"]
    world.joints["stribeck_rad_s"][j] = p["velocity_rad_s"]


def _asymmetric_friction(world: World, j: int, p: Parameters) -> None:
    world.joints["friction_Nm"][j] = p["torque_Nm"]
    world.joints["friction_asymmetry"][j] = p["asymmetry"]


def _presliding(world: World, j: int, p: Parameters) -> None:
    world.joints["friction_Nm"][j] = p["torque_Nm"]
    world.joints["bristle_rad"][j] = p["torque_Nm"] / p["stiffness_Nm_per_rad"]


def _contact(world: World, j: int, stiffness: float, damping_ratio: float) -> None:
    rotor, whole = world.joints["rotor_inertia"][j], world.joints["inertia"][j]
    together = rotor * (whole - rotor) / whole
    world.joints["contact_Nm_per_rad"][j] = stiffness
    damping = 2 * damping_ratio * np.sqrt(stiffness * together)
    world.joints["contact_Nms_per_rad"][j] = damping


def _backlash(world: World, j: int, p: Parameters) -> None:
    _contact(world, j, 600.0, 0.4)
    world.joints["gap_rad"][j] = p["gap_rad"]
    world.joints["seen_behind_contact"][j] = 1.0


def _compliance(world: World, j: int, p: Parameters) -> None:
    _contact(world, j, 1.0 / p["compliance_rad_per_Nm"], 0.05)


def _integral(world: World, j: int, p: Parameters) -> None:
    servo = world.joints[j]
    stall = servo["gear_ratio"] * servo["torque_constant"] * servo["volts"] / servo["ohms"]
    servo["integral_per_rad_s"] = p["ki_Nm_per_rad_s"] / stall


def _cogging(world: World, j: int, p: Parameters) -> None:
    world.joints["cogging_Nm"][j] = p["torque_Nm"]
    world.joints["cogging_period_rad"][j] = p["period_rad"]
    world.joints["cogging_phase"][j] = p["phase_rad"]


def _thermal(world: World, j: int, p: Parameters) -> None:
    world.joints["heat_loss"][j] = p["loss"]
    world.joints["heat_reference_A2"][j] = p["_reference_A2"]


def _quantization(world: World, j: int, p: Parameters) -> None:
    world.steps_rad[j] = p["step_rad"]


def _sag(world: World, _: int, p: Parameters) -> None:
    world.supply = world.supply._replace(sag=p["loss_at_full_load"])


def _droop(world: World, _: int, p: Parameters) -> None:
    world.supply = world.supply._replace(droop_per_s=p["loss_per_min"] / 60.0)


def _jitter(world: World, _: int, p: Parameters) -> None:
    world.link.jitter_s = p["halfwidth_s"]


def _loss(world: World, _: int, p: Parameters) -> None:
    world.link.loss = p["probability"]


def _drift(world: World, _: int, p: Parameters) -> None:
    world.link.drift = p["s_per_s"]


def _drift_size(s: float, scale: Scale, u: Array) -> Parameters:
    """Earlier only where no set-point would take effect before it is sent."""
    size = NOMINAL["clock_drift"] * s
    room = scale.least_latency_s > 30 * size + 0.005
    return {"s_per_s": size * (_sign(u[0]) if room else 1.0)}


NOMINAL: dict[str, float] = {  # at strength 1; units in the README's table
    "coulomb_friction": 0.025,
    "stribeck_friction": 0.02,
    "asymmetric_friction": 0.025,
    "load_friction": 0.1,
    "quadratic_drag": 0.004,
    "backlash": 0.012,
    "compliance": 0.03,
    "deadband": 0.006,
    "torque_saturation": 1.0,
    "torque_asymmetry": 0.12,
    "rate_limit": 15.0,
    "integral_action": 0.5,
    "command_filter": 0.015,
    "acceleration_limit": 400.0,
    "presliding_friction": 0.03,
    "gravity_load": 0.04,
    "unmodelled_inertia": 0.15,
    "cogging": 0.012,
    "thermal_derating": 0.2,
    "encoder_quantization": 2.0,
    "sensor_offset": 0.012,
    "sensor_gain": 0.015,
    "sensor_filter": 0.015,
    "voltage_sag": 0.1,
    "supply_droop": 0.1,
    "latency_jitter": 0.004,
    "packet_loss": 0.01,
    "clock_drift": 2e-4,
}
N = NOMINAL

EFFECTS: dict[str, Effect] = {
    "coulomb_friction": Effect(
        "joint", "speed_sign", "friction",
        lambda s, _, u: {"torque_Nm": N["coulomb_friction"] * s},
        _field("friction_Nm", "torque_Nm"),
    ),
    "stribeck_friction": Effect(
        "joint", "speed_sign", "friction",
        lambda s, _, u: {
            "torque_Nm": N["stribeck_friction"] * s,
            "breakaway_Nm": N["stribeck_friction"] * s * (1.4 + 1.1 * u[0]),
            "velocity_rad_s": _log(0.1, 1.0, u[1]),
        },
        _stribeck,
    ),
    "asymmetric_friction": Effect(
        "joint", "speed_sign", "friction",
        lambda s, _, u: {
            "torque_Nm": N["asymmetric_friction"] * s,
            "asymmetry": _sign(u[0]) * (0.3 + 0.5 * u[1]),
        },
        _asymmetric_friction,
    ),
    "load_friction": Effect(
        "joint", "load", "friction",
        lambda s, _, u: {"ratio": N["load_friction"] * s},
        _field("load_ratio", "ratio"),
    ),
    "quadratic_drag": Effect(
        "joint", "speed", "",
        lambda s, _, u: {"coefficient_Nms2": N["quadratic_drag"] * s},
        _field("drag_Nms2", "coefficient_Nms2"),
    ),
    "backlash": Effect(
        "joint", "speed_sign", "contact",
        lambda s, _, u: {"gap_rad": N["backlash"] * s},
        _backlash,
    ),
    "compliance": Effect(
        "joint", "acceleration", "contact",
        lambda s, _, u: {"compliance_rad_per_Nm": N["compliance"] * s},
        _compliance,
    ),
    "deadband": Effect(
        "joint", "load", "",
        lambda s, _, u: {"halfwidth_rad": N["deadband"] * s},
        _field("deadband_rad", "halfwidth_rad"),
    ),
    "torque_saturation": Effect(
        "joint", "load", "",
        lambda s, scale, u: {"limit_Nm": scale.peak_torque_Nm / (1 + N["torque_saturation"] * s)},
        _field("limit_Nm", "limit_Nm"),
    ),
    "torque_asymmetry": Effect(
        "joint", "load", "",
        lambda s, _, u: {"asymmetry": _sign(u[0]) * N["torque_asymmetry"] * s},
        _field("asymmetry", "asymmetry"),
    ),
    "rate_limit": Effect(
        "joint", "command", "profile",
        lambda s, _, u: {"limit_rad_s": N["rate_limit"] / s},
        _field("rate_rad_s", "limit_rad_s"),
    ),
    "integral_action": Effect(
        "joint", "load", "",
        lambda s, scale, u: {"ki_Nm_per_rad_s": N["integral_action"] * s * scale.servo.kp},
        _integral,
    ),
    "command_filter": Effect(
        "joint", "command", "profile",
        lambda s, _, u: {"time_constant_s": N["command_filter"] * s},
        _field("filter_s", "time_constant_s"),
    ),
    "acceleration_limit": Effect(
        "joint", "command", "profile",
        lambda s, _, u: {"limit_rad_s2": N["acceleration_limit"] / s},
        _field("acceleration_rad_s2", "limit_rad_s2"),
    ),
    "presliding_friction": Effect(
        "joint", "speed_sign", "friction",
        lambda s, _, u: {
            "torque_Nm": N["presliding_friction"] * s,
            "stiffness_Nm_per_rad": _log(2.0, 15.0, u[0]),
        },
        _presliding,
    ),
    "gravity_load": Effect(
        "joint", "position", "",
        lambda s, _, u: {"torque_Nm": N["gravity_load"] * s},
        _field("gravity_Nm", "torque_Nm"),
    ),
    "unmodelled_inertia": Effect(
        "joint", "acceleration", "",
        lambda s, scale, u: {
            "inertia_kgm2": N["unmodelled_inertia"] * s * scale.servo.loads["a"].inertia_kgm2
        },
        _field("extra_inertia", "inertia_kgm2"),
    ),
    "cogging": Effect(
        "joint", "position", "",
        lambda s, _, u: {
            "torque_Nm": N["cogging"] * s,
            "period_rad": _log(0.15, 0.7, u[0]),
            "phase_rad": 2 * np.pi * u[1],
        },
        _cogging,
    ),
    "thermal_derating": Effect(
        "joint", "time", "",
        lambda s, scale, u: {
            "loss": N["thermal_derating"] * s,
            "_reference_A2": scale.mean_square_current_A2,
        },
        _thermal,
    ),
    "encoder_quantization": Effect(
        "joint", "none", "",
        lambda s, scale, u: {
            "step_rad": round(
                scale.servo.sensor.step_rad * (2 + N["encoder_quantization"] * s), 5
            )
        },
        _quantization,
    ),
    "sensor_offset": Effect(
        "joint", "none", "",
        lambda s, _, u: {"offset_rad": _sign(u[0]) * N["sensor_offset"] * s},
        _sensor("offset_rad", "offset_rad"),
    ),
    "sensor_gain": Effect(
        "joint", "position", "",
        lambda s, _, u: {"gain": 1 + _sign(u[0]) * N["sensor_gain"] * s},
        _sensor("gain", "gain"),
    ),
    "sensor_filter": Effect(
        "joint", "speed", "",
        lambda s, _, u: {"time_constant_s": N["sensor_filter"] * s},
        _field("sensor_filter_s", "time_constant_s"),
    ),
    "voltage_sag": Effect(
        "supply", "load", "",
        lambda s, _, u: {"loss_at_full_load": N["voltage_sag"] * s},
        _sag,
    ),
    "supply_droop": Effect(
        "supply", "time", "",
        lambda s, _, u: {"loss_per_min": N["supply_droop"] * s},
        _droop,
    ),
    "latency_jitter": Effect(
        "link", "command", "",
        lambda s, _, u: {"halfwidth_s": N["latency_jitter"] * s},
        _jitter,
    ),
    "packet_loss": Effect(
        "link", "command", "",
        lambda s, _, u: {"probability": N["packet_loss"] * s},
        _loss,
    ),
    "clock_drift": Effect("link", "time", "", _drift_size, _drift),
}  # fmt: skip
