"""Export of the identified actuators as Isaac Lab configurations, as Python text.

Fields: https://isaac-sim.github.io/IsaacLab, ``isaaclab.actuators``, releases 2.3 and 3.0 (which
also names ``effort_limit`` and ``velocity_limit`` ``actuator_...`` and accepts both).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from sim2real.exporters.actuator import (
    SATURATION,
    Actuator,
    Export,
    LeftOut,
    actuators,
    beyond_left_out,
    comment,
    delay_left_out,
    head,
    left_out,
    link_left_out,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "latency_jitter", "stribeck_friction", "unmodelled_inertia")
"""Effects of the catalogue that a configuration expresses, some of them in part."""

PLAIN, MOTOR = "DelayedPDActuatorCfg", "DelayedDCMotorCfg"
"""Classes of configurations; both have ``min_delay`` and ``max_delay``."""

DELAYED_MOTOR = f'''from isaaclab.actuators import DCMotor, DCMotorCfg, DelayedPDActuator, {PLAIN}
from isaaclab.utils import configclass


class DelayedDCMotor(DelayedPDActuator, DCMotor):
    """A motor on its torque-speed line whose set-points are delayed."""


@configclass
class DelayedDCMotorCfg(DCMotorCfg):
    """A DCMotorCfg with the delay of a DelayedPDActuatorCfg, in physics steps."""

    class_type: type = DelayedDCMotor
    min_delay: int = 0
    max_delay: int = 0
'''


def isaaclab(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``actuators(physics_dt)``, a dictionary of configurations.

    A joint whose drive clips before the back-EMF (a torque-speed line) becomes a
    ``DelayedDCMotorCfg``, Isaac Lab's ``DCMotorCfg`` with the delay of its
    ``DelayedPDActuatorCfg``, which any other joint becomes. Delays are in whole physics steps.

    Args:
        model: The fitted model.
        robot: Source of limits (data sheets) where none was identified.
        dropped: Parts that were dropped from the model, to be listed, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    servos = actuators(model, robot)
    lines = [line for actuator in servos for line in _left_out(actuator)]
    lines += [*dropped, *shared_left_out(model)]
    kinds = {_kind(actuator) for actuator in servos}
    text = comment(head(lines))
    if kinds == {PLAIN}:
        text += f"from isaaclab.actuators import {PLAIN}\n"
    else:
        text += DELAYED_MOTOR
    text += "\n\ndef actuators(physics_dt):\n"
    text += '    """For ArticulationCfg.actuators; physics_dt is SimulationCfg.dt, in s."""\n'
    text += "    return {\n"
    text += "".join(_entry(actuator) for actuator in servos)
    return Export(text + "    }\n", tuple(lines))


def _kind(servo: Actuator) -> str:
    return MOTOR if servo.back_emf > 0 and servo.limit else PLAIN


def _entry(servo: Actuator) -> str:
    fields: dict[str, str] = {"joint_names_expr": repr([re.escape(servo.joint)])}
    fields["stiffness"] = f"{servo.kp:.9g}"
    fields["damping"] = f"{servo.kd + servo.back_emf:.9g}"
    if _kind(servo) == MOTOR:
        fields["saturation_effort"] = f"{servo.limit:.9g}"
        fields["effort_limit"] = f"{servo.largest_torque:.9g}"
        fields["velocity_limit"] = f"{servo.no_load_speed:.9g}"
    else:
        if servo.stall_torque is not None:
            fields["effort_limit"] = f"{servo.stall_torque:.9g}"
        if servo.no_load_speed is not None:
            fields["velocity_limit"] = f"{servo.no_load_speed:.9g}"
    spread = servo.value("latency_jitter", "halfwidth_s")
    ends = max(servo.latency - spread, 0.0), servo.latency + spread
    fields["min_delay"], fields["max_delay"] = (f"round({x:.9g} / physics_dt)" for x in ends)
    if servo.armature > 0:
        fields["armature"] = f"{servo.armature:.9g}"
    sliding = servo.value("coulomb_friction", "torque_Nm")
    sticking = sliding + servo.value("stribeck_friction", "breakaway_Nm")
    sliding += servo.value("stribeck_friction", "torque_Nm")
    if sticking > 0:
        fields |= {"friction": f"{sticking:.9g}", "dynamic_friction": f"{sliding:.9g}"}
    body = "".join(f"            {name}={value},\n" for name, value in fields.items())
    return f"        {servo.joint!r}: {_kind(servo)}(\n{body}        ),\n"


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = [*left_out(servo, "Isaac Lab", (*HAS, SATURATION)), *delay_left_out(servo)]

    def add(what: str, why: str) -> None:
        lines.append(LeftOut(servo.joint, what, why))

    if "latency_jitter" in servo.effects:
        add("part of latency_jitter", "the delay is drawn at a reset, not for each set-point")
    if "stribeck_friction" in servo.effects:
        add("velocity_rad_s of stribeck_friction", "friction drops as soon as the joint moves")
    return lines + beyond_left_out(servo) + link_left_out(servo)
