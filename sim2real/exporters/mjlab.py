"""Export of the identified actuators as mjlab configurations, as Python text.

Fields: ``mjlab.actuator.BuiltinPositionActuatorCfg``, releases 1.5 and 1.6 (the package ``mjlab``).
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
    delay_left_out,
    head,
    left_out,
    limit_with_back_emf,
    link_left_out,
    shared_left_out,
)
from sim2real.exporters.soft_friction import constraint
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import SOFT

HAS = ("coulomb_friction", "latency_jitter", "unmodelled_inertia")
"""Effects of the catalogue that a configuration expresses, one of them in part."""

FRICTION = '''

def set_friction(spec, physics_dt):
    """Friction that stops the joints as identified; call it in the spec_fn of the EntityCfg."""
    for name, (time_constant, impedance) in FRICTION.items():
        joint = spec.joint(name)
        joint.solref_friction = (max(time_constant, 2 * physics_dt), 1.0)
        joint.solimp_friction = (impedance, impedance, 0.001, 0.5, 2.0)
'''


def mjlab(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``actuators(physics_dt)``, a tuple of configurations.

    The limit of the drive is ``effort_limit``; the back-EMF, which acts beyond it, is
    ``viscous_damping``. A delay is a whole number of physics steps. MuJoCo's friction is soft by
    default: ``set_friction(spec, physics_dt)`` makes it as stiff as identified.

    Args:
        model: The fitted model.
        robot: Source of limits (data sheets) where none was identified.
        dropped: Parts that were dropped from the model, to be listed, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    lines: list[LeftOut] = []
    servos = []
    for identified in actuators(model, robot):
        servo, moved = limit_with_back_emf(identified, "damping")
        servos.append(servo)
        lines += [*moved, *_left_out(servo)]
    lines += [*dropped, *shared_left_out(model)]
    text = comment(head(lines)) + "from mjlab.actuator import BuiltinPositionActuatorCfg\n"
    soft = {
        servo.joint: constraint(*servo.stopping_times, 0.0)
        for servo in servos
        if _friction(servo) > 0
    }
    if soft:
        rows = "".join(f"    {joint!r}: ({t:.9g}, {d:.9g}),\n" for joint, (t, d) in soft.items())
        text += f"\nFRICTION = {{  # time constant in s and impedance of each joint\n{rows}}}\n"
    text += "\n\ndef actuators(physics_dt):\n"
    text += (
        '    """For EntityArticulationInfoCfg; physics_dt is the time step of MuJoCo, in s."""\n'
    )
    text += "    return (\n" + "".join(map(_entry, servos)) + "    )\n"
    return Export(text + (FRICTION if soft else ""), tuple(lines))


def _friction(servo: Actuator) -> float:
    return servo.value("coulomb_friction", "torque_Nm")


def _entry(servo: Actuator) -> str:
    spread = servo.value("latency_jitter", "halfwidth_s")
    ends = max(servo.latency - spread, 0.0), servo.latency + spread
    fields = {
        "target_names_expr": repr((re.escape(servo.joint),)),
        "stiffness": f"{servo.kp:.9g}",
        "damping": f"{servo.kd:.9g}",
        "viscous_damping": f"{servo.back_emf:.9g}",
        "armature": f"{servo.armature:.9g}",
        "frictionloss": f"{_friction(servo):.9g}",
        "delay_min_lag": f"round({ends[0]:.9g} / physics_dt)",
        "delay_max_lag": f"round({ends[1]:.9g} / physics_dt)",
    }
    if servo.stall_torque is not None:
        fields["effort_limit"] = f"{servo.stall_torque:.9g}"
    body = "".join(f"            {name}={value},\n" for name, value in fields.items())
    return f"        BuiltinPositionActuatorCfg(\n{body}        ),\n"


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = [*left_out(servo, "mjlab", (*HAS, *SOFT)), *delay_left_out(servo)]
    if "latency_jitter" in servo.effects:
        why = "the delay is drawn at each physics step, not for each set-point"
        lines.append(LeftOut(servo.joint, "part of latency_jitter", why))
    return lines + link_left_out(servo)
