"""Python text that configures actuators in Isaac Lab, mjlab, Newton and Genesis, and USD.

Fields and calls: Isaac Lab 2.3 and 3.0 (``isaaclab.actuators``; 3.0 accepts these names) and, for
``BamActuatorCfg``, its development branch of November 2026 (in no release yet); mjlab 1.5 and 1.6
(``BuiltinPositionActuatorCfg``), Newton 1.8 (``newton.actuators`` and its USD schemas; its own
drive for BAM's servos is in no release yet), Genesis (``RigidEntity``).
"""

import re
from collections.abc import Mapping, Sequence

from sim2real.exporters.actuator import Actuator


def numbers(**values: float | None) -> dict[str, str]:
    """The numbers that are known, as Python text."""
    return {name: f"{value:.9g}" for name, value in values.items() if value is not None}


def _called(name: str, fields: Mapping[str, str]) -> str:
    """A call with keyword arguments as an entry of a list, two levels deep."""
    lines = "".join(f"            {n}={x},\n" for n, x in fields.items())
    return f"{name}(\n{lines}        ),\n"


def _steps(servo: Actuator, low: str, high: str) -> dict[str, str]:
    """Shortest and longest delay, with ``latency_jitter``, in whole physics steps."""
    spread = servo.value("latency_jitter", "halfwidth_s")
    ends = {low: max(servo.latency - spread, 0.0), high: servo.latency + spread}
    return {name: f"round({delay:.9g} / physics_dt)" for name, delay in ends.items()}


DELAYED_MOTOR = '''from isaaclab.actuators import (
    DCMotor,
    DCMotorCfg,
    DelayedPDActuator,
    DelayedPDActuatorCfg,
)
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


ISAACLAB = '''

def actuators(physics_dt):
    """For ArticulationCfg.actuators; physics_dt is SimulationCfg.dt, in s."""
    return {
'''


def isaaclab_text(servos: Sequence[Actuator]) -> str:
    """``actuators(physics_dt)``, a dictionary of configurations.

    A joint whose drive clips before the back-EMF (a torque-speed line) becomes a DC motor with the
    delay that any other joint has.
    """
    entries, lines = "", 0
    for servo in servos:
        fields = {"joint_names_expr": repr([re.escape(servo.joint)])}
        fields |= numbers(stiffness=servo.kp, damping=servo.kd + servo.back_emf)
        kind, effort = "DelayedPDActuatorCfg", servo.stall_torque
        if servo.back_emf > 0 and servo.limit:
            lines, kind, effort = lines + 1, "DelayedDCMotorCfg", servo.largest_torque
            fields |= numbers(saturation_effort=servo.limit)
        fields |= numbers(effort_limit=effort, velocity_limit=servo.no_load_speed)
        fields |= _steps(servo, "min_delay", "max_delay")
        fields |= numbers(armature=servo.armature or None)
        sticking = servo.friction + servo.value("stribeck_friction", "breakaway_Nm")
        sliding = servo.friction + servo.value("stribeck_friction", "torque_Nm")
        if sticking > 0:
            fields |= numbers(friction=sticking, dynamic_friction=sliding)
        entries += f"        {servo.joint!r}: " + _called(kind, fields)
    classes = DELAYED_MOTOR if lines else "from isaaclab.actuators import DelayedPDActuatorCfg\n"
    return f"{classes}{ISAACLAB}{entries}    }}\n"


BAM = '''from isaaclab.actuators.actuator_bam_cfg import BamActuatorCfg, BamMotorCfg


def actuators(physics_dt):
    """For ArticulationCfg.actuators; physics_dt is SimulationCfg.dt, in s.

    DriveBam needs SimulationCfg.use_newton_actuators and Newton's solver of MuJoCo. Voltages are
    relative to the supply. Each joint is a group with a delay and a supply of its own; joints of
    one group share both. Play is a hinge of the asset, passive_JOINT_backlash.
    """
    return {
'''
PLAY = "passive_{}_backlash"
"""Name of the hinge with play of a joint, as Isaac Lab's own example has it."""


def bam_text(servos: Sequence[Actuator]) -> str:
    """``actuators(physics_dt)``, configurations of Isaac Lab's ``DriveBam``.

    With the supply 1 the stall torque is K = kt / R and the damping by the back-EMF b = kt^2 / R,
    so kt = b / K. A drive that does not clip before its damping has a K out of reach, and its limit
    is that of the current, which limits the whole torque. All damping is that of the back-EMF.
    """
    entries = ""
    for servo in servos:
        stall, limit = 100 * servo.kp, servo.limit
        if servo.limit and servo.back_emf > 0:
            stall, limit = servo.limit, servo.current_limit
        kt = max(servo.kd + servo.back_emf, 1e-9 * stall) / stall
        falling, motor = servo.effects.get("stribeck_friction", {}), servo.motor
        sliding = falling.get("torque_Nm", 0.0)
        rubs = any("_friction" in name for name in motor)
        fields = {"model": repr("m5" if rubs else "m2" if falling else "m1")}
        fields |= numbers(
            kt=kt,
            resistance=kt / stall,
            error_gain=servo.kp / stall,
            max_current=(limit or 0.0) / kt,
            friction_base=servo.friction + sliding,
            friction_viscous=0.0,
            friction_stribeck=falling.get("breakaway_Nm", sliding) - sliding,
            dtheta_stribeck=falling.get("velocity_rad_s") or motor.get("stribeck_speed_rad_s"),
            alpha=2.0,
            load_friction_motor=motor.get("motor_friction"),
            load_friction_external=motor.get("load_friction"),
            load_friction_motor_stribeck=motor.get("stribeck_motor_friction"),
            load_friction_external_stribeck=motor.get("stribeck_load_friction"),
        )
        values = ", ".join(f"{name}={value}" for name, value in fields.items())
        entry = {"joint_names_expr": repr([re.escape(servo.joint)])}
        entry |= {"motor": f"BamMotorCfg({values})", "kp_fw": "1.0", "vin": "1.0"}
        entry |= numbers(actuator_effort_limit=2 * stall)  # braking adds the back-EMF
        if sag := servo.value("voltage_sag", "loss_at_full_load"):
            gain = 2 * sag / servo.kp
            entry |= {"vin_drop_gain_range": f"({gain:.9g}, {gain:.9g})"} | numbers(vin_min=1 - sag)
        entry |= _steps(servo, "min_delay", "max_delay") | numbers(armature=servo.armature)
        if servo.value("backlash", "control_on_output"):
            entry["backlash_joint_template"] = repr(PLAY)
        entries += f"        {servo.joint!r}: " + _called("BamActuatorCfg", entry)
    return f"{BAM}{entries}    }}\n"


MJLAB = '''

def actuators(physics_dt):
    """For EntityArticulationInfoCfg; physics_dt is the time step of MuJoCo, in s."""
    return (
'''
MJLAB_FRICTION = '''

def set_friction(spec, physics_dt):
    """Friction that stops the joints as identified; call it in the spec_fn of the EntityCfg."""
    for name, (time_constant, impedance) in FRICTION.items():
        joint = spec.joint(name)
        joint.solref_friction = (max(time_constant, 2 * physics_dt), 1.0)
        joint.solimp_friction = (impedance, impedance, 0.001, 0.5, 2.0)
'''


def mjlab_text(servos: Sequence[Actuator]) -> str:
    """``actuators(physics_dt)``, a tuple of configurations, and ``set_friction``.

    The limit of the drive is ``effort_limit``; the back-EMF, which acts beyond it, is
    ``viscous_damping``.
    """
    entries, stops = "", ""
    for servo in servos:
        fields = {"target_names_expr": repr((re.escape(servo.joint),))}
        fields |= numbers(stiffness=servo.kp, damping=servo.kd, viscous_damping=servo.back_emf)
        fields |= numbers(armature=servo.armature, frictionloss=servo.friction)
        fields |= _steps(servo, "delay_min_lag", "delay_max_lag")
        fields |= numbers(effort_limit=servo.stall_torque)
        entries += "        " + _called("BuiltinPositionActuatorCfg", fields)
        if servo.friction > 0:
            stops += "    {!r}: ({:.9g}, {:.9g}),\n".format(servo.joint, *servo.stop())
    text = "from mjlab.actuator import BuiltinPositionActuatorCfg\n"
    if stops:
        text += f"\nFRICTION = {{  # time constant in s and impedance of each joint\n{stops}}}\n"
    return f"{text}{MJLAB}{entries}    )\n" + (MJLAB_FRICTION if stops else "")


NEWTON = '''

def add_actuators(builder, physics_dt):
    """Actuators of a newton.ModelBuilder, to be called before finalize; physics_dt in s.

    With MuJoCo's solver, call SolverMuJoCo.register_custom_attributes(builder) before the robot is
    added, so that friction stops the joints as identified: it is soft by default. A drive acts with
    the speed at the start of a step: half a step of damping in the armature makes it the mean.
    """
    soft = builder.custom_attributes
    for number, label in enumerate(builder.joint_label):
        values = SERVOS.get(label, SERVOS.get(label.rsplit("/")[-1]))
        if values is None:
            continue
        dof = builder.joint_qd_start[number]
        builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
        half_step = 0.5 * physics_dt * values["unlimited_kd"]
        builder.joint_armature[dof] = values["armature"] + half_step
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


def _clamping(servo: Actuator) -> tuple[str, dict[str, str]]:
    """Newton's clamping stage of a servo, and its numbers; none without a limit."""
    if servo.limit is None or servo.back_emf <= 0:
        return "ClampingMaxEffort", numbers(max_effort=servo.stall_torque)
    return "ClampingDCMotor", numbers(
        saturation_effort=servo.limit,
        velocity_limit=servo.limit / servo.back_emf,
        max_motor_effort=servo.largest_torque,
    )


def newton_text(servos: Sequence[Actuator]) -> str:
    """``add_actuators(builder, physics_dt)``.

    A drive that clips before the back-EMF is a PD drive whose torque is within the torque-speed
    line: both clip ``kp e - kd v`` to ``[-K - b v, K - b v]``.
    """
    entries, used = "", {"DrivePD"}
    for servo in servos:
        clamp, limits = _clamping(servo)
        used |= {clamp} if limits else set()
        shown = ", ".join(f'"{name}": {value}' for name, value in limits.items())
        fields = numbers(kp=servo.kp, kd=servo.kd + servo.back_emf, latency_s=servo.latency)
        fields |= numbers(unlimited_kd=servo.unlimited_damping)
        fields |= numbers(armature=servo.armature, friction=servo.friction)
        body = "".join(f'        "{name}": {value},\n' for name, value in fields.items())
        body += '        "stop": ({:.9g}, {:.9g}),'.format(*servo.stop())
        body += "  # time constant in s and impedance\n"
        body += f'        "clamping": [{f"({clamp}, {{{shown}}})" if limits else ""}],\n'
        entries += f"    {servo.joint!r}: {{\n{body}    }},\n"
    text = f"from newton.actuators import {', '.join(sorted(used))}\n\n"
    return f"{text}SERVOS = {{\n{entries}}}\n{NEWTON}"


USD_STEPS_PER_S = 1000
USD = """#usda 1.0
(
    defaultPrim = "bench"
    metersPerUnit = 1
)
{comments}
def PhysicsScene "scene" (
    prepend apiSchemas = ["NewtonSceneAPI"]
)
{{
    float physics:gravityMagnitude = 0
    uniform int newton:timeStepsPerSecond = {steps}
}}

def Xform "bench"
{{
{servos}}}
"""
USD_SERVO = """    def Xform "{name}_link" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {{
        float physics:mass = 0.1
        float3 physics:diagonalInertia = ({inertia}, {inertia}, {inertia})
    }}

    def PhysicsRevoluteJoint "{name}" (
        prepend apiSchemas = ["NewtonJointAPI"]
    )
    {{
        rel physics:body1 = </bench/{name}_link>
        uniform token physics:axis = "Y"
        float newton:armature = {armature}
        float newton:friction = {friction}
        uniform double[] mjc:solreffriction = [{time_constant}, 1]
        uniform double[] mjc:solimpfriction = [{impedance}, {impedance}, 0.001, 0.5, 2]
    }}

    def NewtonActuator "{name}_actuator" (
        prepend apiSchemas = [{schemas}]
    )
    {{
        rel newton:targets = </bench/{name}>
{attributes}    }}

"""


def usd_text(servos: Sequence[Actuator], comments: str) -> str:
    """A USD file with a bench: an inertia on each joint, and a ``NewtonActuator`` that turns it.

    Delays, and half a step of damping in the armature (see ``NEWTON``), are for steps of the file's
    ``PhysicsScene``, of ``1 / USD_STEPS_PER_S``.
    """
    text = ""
    for servo in servos:
        name = re.sub(r"\W", "_", f"_{servo.joint}" if servo.joint[0].isdigit() else servo.joint)
        clamp, limits = _clamping(servo)
        schemas = ["NewtonPDControlAPI"]
        schemas += [f"Newton{clamp.removeprefix('Clamping')}ClampingAPI"] if limits else []
        values = numbers(kp=servo.kp, kd=servo.kd + servo.back_emf) | limits
        camel = {re.sub("_(.)", lambda x: x[1].upper(), name): x for name, x in values.items()}
        lines = [f"float newton:{name} = {x}" for name, x in camel.items()]
        if delay := round(servo.latency * USD_STEPS_PER_S):
            schemas.append("NewtonActuatorDelayAPI")
            lines.append(f"int newton:delaySteps = {delay}")
        stop = servo.stop(2 / USD_STEPS_PER_S)
        text += USD_SERVO.format(
            name=name,
            schemas=", ".join(f'"{one}"' for one in schemas),
            attributes="".join(f"        {line}\n" for line in lines),
            **numbers(
                inertia=servo.inertia + servo.beyond_load - servo.armature,
                armature=servo.armature + 0.5 * servo.unlimited_damping / USD_STEPS_PER_S,
                friction=servo.friction,
                time_constant=stop[0],
                impedance=stop[1],
            ),
        )
    return USD.format(comments=comments, steps=USD_STEPS_PER_S, servos=text)


GENESIS = '''
JOINTS = [{joints}]


def set_actuators(entity):
    """Gains and losses, for entity.control_dofs_position(angles, dofs)."""
    dofs = [entity.get_joint(name).dofs_idx_local[0] for name in JOINTS]
{calls}    return dofs
'''


def genesis_text(servos: Sequence[Actuator]) -> str:
    """``set_actuators(entity)``, to be called after the scene is built."""
    names = ("kp", "kv", "damping", "armature", "frictionloss")
    rows = [(x.kp, x.kd, x.back_emf, x.armature, x.friction) for x in servos]
    columns = [", ".join(f"{x:.9g}" for x in column) for column in zip(*rows, strict=True)]
    calls = dict(zip(names, columns, strict=True))
    limits = [x.stall_torque for x in servos]
    if any(limit is not None for limit in limits):
        upper = ["float('inf')" if limit is None else f"{limit:.9g}" for limit in limits]
        lower = ["-float('inf')" if limit is None else f"{-limit:.9g}" for limit in limits]
        calls["force_range"] = f"{', '.join(lower)}], [{', '.join(upper)}"
    return GENESIS.format(
        joints=", ".join(repr(servo.joint) for servo in servos),
        calls="".join(f"    entity.set_dofs_{n}([{x}], dofs)\n" for n, x in calls.items()),
    )
