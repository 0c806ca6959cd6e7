"""The identified actuators for Genesis, in Python text.

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
    left_out,
    listed,
    quantity,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that Genesis expresses."""

LACKS = {
    "stribeck_friction": "its friction is a constant torque",
    "presliding_friction": "its friction is a constant torque",
    "asymmetric_friction": "its friction is the same both ways",
    "load_friction": "its friction does not depend on the load",
    "quadratic_drag": "its damping is linear in the speed",
    "gravity_load": "add the weight to the link",
}


def genesis(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``set_actuators(entity)``, to be called once the scene is built.

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
    head = ["Actuators identified by sim2real; SI units, radians.", *listed(lines)]
    names = ", ".join(repr(actuator.joint) for actuator in given)
    text = comment(head) + f"\nJOINTS = [{names}]\n\n\n"
    text += "def set_actuators(entity):\n"
    text += '    """Gains and losses, for entity.control_dofs_position(angles, dofs)."""\n'
    text += "    dofs = [entity.get_joint(name).dofs_idx_local[0] for name in JOINTS]\n"
    for call, values in _calls(given).items():
        text += f"    entity.{call}({values}, dofs)\n"
    return Export(text + "    return dofs\n", tuple(lines))


def _calls(given: tuple[Actuator, ...]) -> dict[str, str]:
    def every(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"

    armature = [max(one.value("unmodelled_inertia", "inertia_kgm2"), 0.0) for one in given]
    friction = [one.value("coulomb_friction", "torque_Nm") for one in given]
    calls = {
        "set_dofs_kp": every([one.kp for one in given]),
        "set_dofs_kv": every([one.kd for one in given]),
        "set_dofs_damping": every([one.back_emf for one in given]),
        "set_dofs_armature": every(armature),
        "set_dofs_frictionloss": every(friction),
    }
    limits = [one.stall_torque for one in given]
    if any(limit is not None for limit in limits):
        most = ", ".join("float('inf')" if limit is None else f"{limit:.9g}" for limit in limits)
        least = ", ".join("-float('inf')" if limit is None else f"{-limit:.9g}" for limit in limits)
        calls["set_dofs_force_range"] = f"[{least}], [{most}]"
    return calls


def _left_out(given: Actuator) -> list[LeftOut]:
    lines = left_out(given, HAS, LACKS, "Genesis")
    why = "position control has no delay; hold set-points back for so long"
    lines += quantity(given.joint, "latency", given.latency, "s", why)
    if given.value("unmodelled_inertia", "inertia_kgm2") < 0:
        why = "an armature is not negative; take it off the link's inertia"
        lines.append(LeftOut(given.joint, "unmodelled_inertia", why))
    load = f"inertia of the load ({given.inertia:.6g} kg m2)"
    lines.append(LeftOut(given.joint, load, "it belongs to the link"))
    return lines
