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
    left_out,
    listed,
    quantity,
    rotor_inertia,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("backlash", "coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that Genesis expresses."""

LACKS = {
    "stribeck_friction": "its friction is a constant torque",
    "presliding_friction": "its friction is a constant torque",
    "asymmetric_friction": "its friction is the same both ways",
    "load_friction": "its friction does not depend on the load",
    "quadratic_drag": "its damping is linear in the speed",
    "gravity_load": "add the weight to the link",
}


PLAY = '''

def with_play(urdf):
    """URDF in which a rotor turns each link with play, whose joint NAME_play moves in the gap.

    The servo turns the joint NAME, and the angle of the link is the sum of both.
    """
    root = ElementTree.fromstring(urdf)
    for name, (gap, rotor, _) in PLAY.items():
        joint = next(j for j in root.findall("joint") if j.get("name") == name)
        link = ElementTree.SubElement(root, "link", name=name + "_rotor")
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value="0.001")
        turning = dict.fromkeys(("ixx", "iyy", "izz"), str(rotor))
        ElementTree.SubElement(inertial, "inertia", turning, ixy="0", ixz="0", iyz="0")
        play = ElementTree.SubElement(root, "joint", name=name + "_play", type="revolute")
        ElementTree.SubElement(play, "parent", link=name + "_rotor")
        ElementTree.SubElement(play, "child", link=joint.find("child").get("link"))
        axis = joint.find("axis")
        ElementTree.SubElement(play, "axis", {"xyz": "1 0 0"} if axis is None else axis.attrib)
        limit = {"lower": str(-gap / 2), "upper": str(gap / 2), "effort": "1e6", "velocity": "1e6"}
        ElementTree.SubElement(play, "limit", limit)
        joint.find("child").set("link", name + "_rotor")
    return ElementTree.tostring(root, encoding="unicode")


def set_play(entity, physics_dt):
    """Inertia of the output, and the flanks as rigid as the time step allows."""
    for name, (_, _, armature) in PLAY.items():
        joint = entity.get_joint(name + "_play")
        joint.set_sol_params([2 * physics_dt, 1.0, 0.99, 0.9999, 1e-4, 0.5, 2.0])
        entity.set_dofs_kp([0.0], joint.dofs_idx_local)
        entity.set_dofs_kv([0.0], joint.dofs_idx_local)
        entity.set_dofs_armature([armature], joint.dofs_idx_local)
'''


def genesis(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """Python text that defines ``set_actuators(entity)``, to be called after the scene is built.

    Play needs a second joint: ``with_play(urdf)`` adds it to the robot's description, ``set_play``
    its inertia and stiffness.

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
    head = ["Actuators identified by sim2real; SI units, radians.", *listed(lines)]
    names = ", ".join(repr(actuator.joint) for actuator in servos)
    play = {servo.joint: _play(servo) for servo in servos if servo.value("backlash", "gap_rad")}
    text = comment(head) + ("from xml.etree import ElementTree\n" if play else "")
    text += f"\nJOINTS = [{names}]\n"
    if play:
        rows = "".join(f"    {joint!r}: ({values}),\n" for joint, values in play.items())
        text += "# gap in rad; rotor and added inertia of the output in kg m2\n"
        text += f"PLAY = {{\n{rows}}}\n"
    text += "\n\n"
    text += "def set_actuators(entity):\n"
    text += '    """Gains and losses, for entity.control_dofs_position(angles, dofs)."""\n'
    text += "    dofs = [entity.get_joint(name).dofs_idx_local[0] for name in JOINTS]\n"
    for call, values in _calls(servos).items():
        text += f"    entity.{call}({values}, dofs)\n"
    return Export(text + "    return dofs\n" + (PLAY if play else ""), tuple(lines))


def _calls(servos: tuple[Actuator, ...]) -> dict[str, str]:
    def listing(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"

    armature = [0.0 if _has_play(servo) else max(_added(servo), 0.0) for servo in servos]
    # In a chain, friction of the joint in the gap would act between rotor and link: the friction of
    # the output, which acts on the base, is on the motor's side.
    friction = [
        servo.value("coulomb_friction", "torque_Nm") + servo.value("backlash", "output_friction_Nm")
        for servo in servos
    ]
    calls = {
        "set_dofs_kp": listing([servo.kp for servo in servos]),
        "set_dofs_kv": listing([servo.kd for servo in servos]),
        "set_dofs_damping": listing([servo.back_emf for servo in servos]),
        "set_dofs_armature": listing(armature),
        "set_dofs_frictionloss": listing(friction),
    }
    limits = [servo.stall_torque for servo in servos]
    if any(limit is not None for limit in limits):
        upper = ", ".join("float('inf')" if limit is None else f"{limit:.9g}" for limit in limits)
        lower = ", ".join("-float('inf')" if limit is None else f"{-limit:.9g}" for limit in limits)
        calls["set_dofs_force_range"] = f"[{lower}], [{upper}]"
    return calls


def _has_play(servo: Actuator) -> bool:
    return servo.value("backlash", "gap_rad") > 0


def _added(servo: Actuator) -> float:
    """Inertia of the output beside that of the link, kg m2; the rotor's side of play is apart."""
    added = servo.value("unmodelled_inertia", "inertia_kgm2")
    return added - rotor_inertia(servo) if _has_play(servo) else added


def _play(servo: Actuator) -> str:
    """The numbers of ``PLAY``."""
    values = (
        servo.value("backlash", "gap_rad"),
        rotor_inertia(servo),
        max(_added(servo), 0.0),
    )
    return ", ".join(f"{value:.9g}" for value in values)


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = left_out(servo, HAS, LACKS, "Genesis")
    why = "position control has no delay; delay the set-points by this time"
    lines += quantity(servo.joint, "latency", servo.latency, "s", why)
    if (added := _added(servo)) < 0:
        what = "part of the rotor's inertia" if _has_play(servo) else "unmodelled_inertia"
        why = "an armature cannot be negative; subtract it from the link's inertia"
        lines.append(LeftOut(servo.joint, f"{what} ({added:.6g} kg m2)", why))
    if friction := servo.value("backlash", "output_friction_Nm"):
        why = "it acts on the motor's side and does not hold the output in the gap"
        lines += quantity(servo.joint, "place of the output's friction", friction, "N m", why)
    load = f"inertia of the load ({servo.inertia:.6g} kg m2)"
    lines.append(LeftOut(servo.joint, load, "it belongs to the link"))
    return lines
