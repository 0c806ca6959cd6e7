"""Export of the identified actuators to Genesis, as Python text.

Calls: https://genesis-world.readthedocs.io, ``RigidEntity``.
"""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.exporters.actuator import (
    Actuator,
    Export,
    LeftOut,
    actuators,
    comment,
    head,
    left_out,
    link_left_out,
    quantity,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that Genesis expresses."""


def genesis(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``set_actuators(entity)``, to be called after the scene is built.

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
    names = ", ".join(repr(actuator.joint) for actuator in servos)
    text = comment(head(lines)) + f"\nJOINTS = [{names}]\n\n\n"
    text += "def set_actuators(entity):\n"
    text += '    """Gains and losses, for entity.control_dofs_position(angles, dofs)."""\n'
    text += "    dofs = [entity.get_joint(name).dofs_idx_local[0] for name in JOINTS]\n"
    for call, values in _calls(servos).items():
        text += f"    entity.{call}({values}, dofs)\n"
    return Export(text + "    return dofs\n", tuple(lines))


def _calls(servos: tuple[Actuator, ...]) -> dict[str, str]:
    def listing(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"

    friction = [servo.value("coulomb_friction", "torque_Nm") for servo in servos]
    calls = {
        "set_dofs_kp": listing([servo.kp for servo in servos]),
        "set_dofs_kv": listing([servo.kd for servo in servos]),
        "set_dofs_damping": listing([servo.back_emf for servo in servos]),
        "set_dofs_armature": listing([servo.armature for servo in servos]),
        "set_dofs_frictionloss": listing(friction),
    }
    limits = [servo.stall_torque for servo in servos]
    if any(limit is not None for limit in limits):
        upper = ", ".join("float('inf')" if limit is None else f"{limit:.9g}" for limit in limits)
        lower = ", ".join("-float('inf')" if limit is None else f"{-limit:.9g}" for limit in limits)
        calls["set_dofs_force_range"] = f"[{lower}], [{upper}]"
    return calls


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = left_out(servo, "Genesis", HAS)
    why = "position control has no delay; delay the set-points by this time"
    lines += quantity(servo.joint, "latency", servo.latency, "s", why)
    return lines + link_left_out(servo)
