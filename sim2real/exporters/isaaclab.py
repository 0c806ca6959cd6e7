"""The identified actuators as Isaac Lab configurations, in Python text.

Fields: https://isaac-sim.github.io/IsaacLab, ``isaaclab.actuators``, releases 2.3 and 3.0 (which
calls ``effort_limit`` and ``velocity_limit`` also ``actuator_...`` and takes both).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from sim2real.exporters.actuator import (
    Actuator,
    Export,
    LeftOut,
    actuators,
    comment,
    left_out,
    listed,
    quantity,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "latency_jitter", "stribeck_friction", "unmodelled_inertia")
"""Effects of the catalogue that a configuration expresses, some of them in part."""

LACKS = {
    "presliding_friction": "its friction is rigid until it slips",
    "asymmetric_friction": "its friction is the same both ways",
    "load_friction": "its friction does not depend on the load",
    "quadratic_drag": "its viscous friction is linear in the speed",
    "gravity_load": "add the weight to the link",
    "sensor_offset": "add it to the observation",
    "sensor_gain": "scale the observation",
    "sensor_filter": "filter the observation",
    "encoder_quantization": "round the observation",
    "packet_loss": "leave actions out in the environment",
}


def isaaclab(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``actuators(physics_dt)``, a dictionary of configurations.

    A joint whose drive clips before the back-EMF (a torque-speed line) becomes a ``DCMotorCfg``,
    any other a ``DelayedPDActuatorCfg``, whose delay is in whole physics steps.

    Args:
        model: The fitted model.
        robot: Its data sheets give limits where none was identified, if there is one.
        dropped: What the model had more, for the file to list, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    given = actuators(model, robot)
    lines = [line for actuator in given for line in _left_out(actuator)]
    lines += [*dropped, *shared_left_out(model)]
    kinds = sorted({_kind(actuator) for actuator in given})
    head = ["Actuators identified by sim2real; SI units, radians.", *listed(lines)]
    text = comment(head) + f"from isaaclab.actuators import {', '.join(kinds)}\n\n\n"
    text += "def actuators(physics_dt):\n"
    text += '    """For ArticulationCfg.actuators; physics_dt is SimulationCfg.dt, in s."""\n'
    text += "    return {\n"
    text += "".join(_entry(actuator) for actuator in given)
    return Export(text + "    }\n", tuple(lines))


def _kind(given: Actuator) -> str:
    return "DCMotorCfg" if given.back_emf > 0 and given.limit else "DelayedPDActuatorCfg"


def _entry(given: Actuator) -> str:
    fields: dict[str, str] = {"joint_names_expr": repr([re.escape(given.joint)])}
    fields["stiffness"] = f"{given.kp:.9g}"
    fields["damping"] = f"{given.kd + given.back_emf:.9g}"
    if _kind(given) == "DCMotorCfg":
        fields["saturation_effort"] = f"{given.limit:.9g}"
        # Braking adds the back-EMF: up to twice the stall torque, which effort_limit must not cut.
        fields["effort_limit"] = f"{2 * (given.limit or 0):.9g}"
        fields["velocity_limit"] = f"{given.no_load_speed:.9g}"
    else:
        if given.stall_torque is not None:
            fields["effort_limit"] = f"{given.stall_torque:.9g}"
        if given.no_load_speed is not None:
            fields["velocity_limit"] = f"{given.no_load_speed:.9g}"
        spread = given.value("latency_jitter", "halfwidth_s")
        ends = max(given.latency - spread, 0.0), given.latency + spread
        fields["min_delay"], fields["max_delay"] = (f"round({x:.9g} / physics_dt)" for x in ends)
    if (armature := given.value("unmodelled_inertia", "inertia_kgm2")) > 0:
        fields["armature"] = f"{armature:.9g}"
    sliding = given.value("coulomb_friction", "torque_Nm")
    sticking = sliding + given.value("stribeck_friction", "breakaway_Nm")
    sliding += given.value("stribeck_friction", "torque_Nm")
    if sticking > 0:
        fields |= {"friction": f"{sticking:.9g}", "dynamic_friction": f"{sliding:.9g}"}
    body = "".join(f"            {name}={value},\n" for name, value in fields.items())
    return f"        {given.joint!r}: {_kind(given)}(\n{body}        ),\n"


def _left_out(given: Actuator) -> list[LeftOut]:
    lines = left_out(given, HAS, LACKS, "Isaac Lab")

    def add(what: str, why: str) -> None:
        lines.append(LeftOut(given.joint, what, why))

    if _kind(given) == "DCMotorCfg":
        why = "DCMotorCfg has no delay; hold actions back"
        lines += quantity(given.joint, "latency", given.latency, "s", why)
        if "latency_jitter" in given.effects:
            add("latency_jitter", "DCMotorCfg has no delay")
    else:
        if given.latency:
            add("fractions of a step of the latency", "a delay is a whole number of physics steps")
        if "latency_jitter" in given.effects:
            add("part of latency_jitter", "the delay is drawn at a reset, not for each set-point")
    if "stribeck_friction" in given.effects:
        add("velocity_rad_s of stribeck_friction", "friction drops as soon as the joint moves")
    if given.value("unmodelled_inertia", "inertia_kgm2") < 0:
        add("unmodelled_inertia", "an armature is not negative; take it off the link's inertia")
    add(f"inertia of the load ({given.inertia:.6g} kg m2)", "it belongs to the link")
    return lines
