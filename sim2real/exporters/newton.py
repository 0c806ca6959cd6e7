"""Export of the identified actuators to Newton, as Python text.

Calls: ``newton.ModelBuilder.add_actuator`` and ``newton.actuators``, release 1.8 (the package
``newton``). Drives and input processors for BAM's servos and for backlash are on Newton's main
branch, in no release yet; they are not used.
"""

from __future__ import annotations

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
from sim2real.exporters.soft_friction import constraint
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import SOFT

HAS = ("coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that Newton expresses."""

LACKS = {
    "backlash": "its processor for backlash is in no release yet",
    "latency_jitter": "a delay is constant",
}

FUNCTION = '''

def add_actuators(builder, physics_dt):
    """Actuators of a newton.ModelBuilder, to be called before finalize; physics_dt in s.

    With MuJoCo's solver, call SolverMuJoCo.register_custom_attributes(builder) before the robot is
    added, so that friction stops the joints as identified: it is soft by default.
    """
    soft = builder.custom_attributes
    for number, label in enumerate(builder.joint_label):
        values = SERVOS.get(label, SERVOS.get(label.rsplit("/")[-1]))
        if values is None:
            continue
        dof = builder.joint_qd_start[number]
        builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
        builder.joint_armature[dof] = values["armature"]
        builder.joint_friction[dof] = values["friction"]
        if "mujoco:solreffriction" in soft:
            time_constant, impedance = values["stop"]
            time_constant = max(time_constant, 2 * physics_dt)
            soft["mujoco:solreffriction"].values[dof] = (time_constant, 1.0)
            soft["mujoco:solimpfriction"].values[dof] = (impedance, impedance, 0.001, 0.5, 2.0)
        builder.add_actuator(
            DrivePD,
            index=dof,
            pos_index=builder.joint_q_start[number],
            delay_steps=round(values["latency_s"] / physics_dt) or None,
            clamping=values["clamping"],
            kp=values["kp"],
            kd=values["kd"],
        )
'''


def newton(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``add_actuators(builder, physics_dt)``.

    A drive that clips before the back-EMF is a PD drive whose torque is within the torque-speed
    line: both clip ``kp e - kd v`` to ``[-K - b v, K - b v]``. A limit of the current is the
    largest torque at any speed.

    Args:
        model: The fitted model.
        robot: Source of limits (data sheets) where none was identified.
        dropped: Parts that were dropped from the model, to be listed, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    servos = actuators(model, robot)
    lines = [line for servo in servos for line in _left_out(servo)]
    lines += [*dropped, *shared_left_out(model)]
    used = sorted({"DrivePD", *(name for servo in servos for name in _clamping(servo)[:1])})
    text = comment(head(lines)) + f"from newton.actuators import {', '.join(used)}\n\n"
    text += "SERVOS = {\n" + "".join(map(_entry, servos)) + "}\n"
    return Export(text + FUNCTION, tuple(lines))


def _clamping(servo: Actuator) -> tuple[str, str] | tuple[()]:
    """Class and arguments of the limit of a drive; empty if none is known."""
    limit = servo.stall_torque
    if limit is None:
        return ()
    if servo.limit is not None and servo.back_emf > 0:
        line = {"saturation_effort": limit, "velocity_limit": limit / servo.back_emf}
        values = line | {"max_motor_effort": servo.largest_torque}
        return "ClampingDCMotor", _dictionary(values)
    return "ClampingMaxEffort", _dictionary({"max_effort": limit})


def _dictionary(values: dict[str, float]) -> str:
    return "{" + ", ".join(f'"{name}": {value:.9g}' for name, value in values.items()) + "}"


def _entry(servo: Actuator) -> str:
    time_constant, impedance = constraint(*servo.stopping_times, 0.0)
    fields = {
        "kp": f"{servo.kp:.9g}",
        "kd": f"{servo.kd + servo.back_emf:.9g}",
        "latency_s": f"{servo.latency:.9g}",
        "armature": f"{servo.armature:.9g}",
        "friction": f"{servo.value('coulomb_friction', 'torque_Nm'):.9g}",
        "stop": f"({time_constant:.9g}, {impedance:.9g}),  # time constant in s and impedance",
        "clamping": "[(" + ", ".join(_clamping(servo)) + ")]" if _clamping(servo) else "[]",
    }
    body = "".join(
        f'        "{name}": {value}' + ("\n" if name == "stop" else ",\n")
        for name, value in fields.items()
    )
    return f"    {servo.joint!r}: {{\n{body}    }},\n"


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = left_out(servo, "Newton", (*HAS, *SOFT, SATURATION), LACKS)
    return [*lines, *beyond_left_out(servo), *delay_left_out(servo), *link_left_out(servo)]
