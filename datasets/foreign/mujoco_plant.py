"""Servos as MuJoCo simulates them: position actuators, armature, damping, friction, two bodies.

Needs ``pip install mujoco``. The actuator is MuJoCo's: force = kp x ctrl - kv x speed within its
force range, where ctrl is the error as the controller last saw it. Play and compliance are a second
body on a hinge of its own, limited to the gap or held by a spring; dry friction acts on either. On
the output's side it is the friction of a tendon whose length is the output's angle.
"""

from __future__ import annotations

from math import exp, inf, sin

import mujoco
import numpy as np
from bench import Load
from foreign_servos import SLOW_LOOP_HZ, ForeignServo
from foreign_world import Acting, held
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S, CONTACT_STEP_S = 5e-4, 2.5e-4
IMPEDANCE = "0.995 0.995 0.001"
"""Of dry friction. With MuJoCo's default, 0.9, a loaded shaft creeps by milliradians per second."""
_XML = """
<mujoco>
 <option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.80665"/>
 <compiler inertiafromgeom="false" angle="radian"/>
 <worldbody>
  <body name="shaft">
   <joint name="shaft" type="hinge" axis="0 1 0" armature="{armature}" damping="{damping}"
     frictionloss="{friction}" solreffriction="{soft} 1" solimpfriction="{impedance}"/>
   {shaft}
  </body>
 </worldbody>
 {output_friction}
 <actuator>
  <general name="servo" joint="shaft" gainprm="{kp}" biastype="affine" biasprm="0 0 -{kv}"
    forcelimited="true" forcerange="-{limit} {limit}"/>
 </actuator>
</mujoco>
"""
_LOAD = '<inertial mass="{mass}" pos="0 0 -{length}" diaginertia="{rest} {rest} {rest}"/>'
_SECOND = """<inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>
   <body name="load"><joint name="play" type="hinge" axis="0 1 0" {hinge}/>{load}</body>"""
_OUTPUT_FRICTION = """<tendon><fixed name="output" frictionloss="{friction}"
  solreffriction="{soft} 1" solimpfriction="{impedance}"><joint joint="shaft" coef="1"/>
  <joint joint="play" coef="1"/></fixed>
 </tendon>"""


def _model(servo: ForeignServo, load: Load, acting: Acting) -> mujoco.MjModel:
    weight = {"mass": 1e-6, "length": 0.0}
    if load.pendulum_mass_kg > 0:
        weight = {"mass": load.pendulum_mass_kg, "length": load.pendulum_length_m}
    rest = load.inertia_kgm2 - servo.rotor_inertia - weight["mass"] * weight["length"] ** 2
    shaft = _LOAD.format(**weight, rest=max(rest, 1e-8))
    rotor, step = servo.rotor_inertia, STEP_S
    hinge = ""
    if "backlash" in acting:
        half = 0.5 * acting["backlash"]["gap_rad"]
        hinge = f'limited="true" range="-{half} {half}" solreflimit="0.0012 1"'
    elif "compliance" in acting:
        stiff = 1 / acting["compliance"]["compliance_rad_per_Nm"]
        damping = 0.1 * np.sqrt(stiff * rotor)
        hinge = f'stiffness="{stiff}" damping="{damping}"'
    if hinge:
        step, shaft = CONTACT_STEP_S, _SECOND.format(hinge=hinge, load=shaft)
    armature = rotor + acting.get("unmodelled_inertia", {}).get("inertia_kgm2", 0.0)
    limit = acting.get("torque_saturation", {}).get("limit_Nm", inf)
    friction = servo.dry_friction_Nm + acting.get("coulomb_friction", {}).get("torque_Nm", 0.0)
    soft, output_friction = 2.5 * step, ""
    if hinge and servo.friction_on_output and friction:
        output_friction = _OUTPUT_FRICTION.format(friction=friction, soft=soft, impedance=IMPEDANCE)
        friction = 0.0
    return mujoco.MjModel.from_xml_string(
        _XML.format(
            step=step,
            armature=armature,
            damping=(1 - servo.firmware_damping) * servo.kd,
            kv=servo.firmware_damping * servo.kd,
            friction=friction,
            soft=soft,
            impedance=IMPEDANCE,
            shaft=shaft,
            output_friction=output_friction,
            kp=servo.kp,
            limit=min(servo.stall_Nm, limit),
        )
    )


def simulate(
    servo: ForeignServo,
    load: Load,
    acting: Acting,
    grid: Array,
    arrivals: Array,
    setpoints: Array,
    windows: list[tuple[float, float]],
) -> Array:
    """The angle that the recorded sensor sees, rad, at the times ``grid`` (T,), from rest."""
    model = _model(servo, load, acting)
    data = mujoco.MjData(model)
    step = float(model.opt.timestep)
    steps = int(np.ceil(grid[-1] / step)) + 1
    target = held(arrivals, setpoints, np.arange(steps) * step).tolist()
    turn = max(1, round(1 / (servo.loop_Hz * step)))
    at_once = servo.loop_Hz < SLOW_LOOP_HZ
    ripple, waves, phase = (
        servo.nuisances[k] for k in ("ripple_Nm", "ripple_per_rad", "ripple_phase")
    )
    dead = acting.get("deadband", {}).get("halfwidth_rad", 0.0)
    integral_rate = acting.get("integral_action", {}).get("ki_Nm_per_rad_s", 0.0) / servo.kp
    drag = acting.get("quadratic_drag", {}).get("coefficient_Nms2", 0.0)
    weight = acting.get("gravity_load", {}).get("torque_Nm", 0.0)
    cogging = acting.get("cogging")
    shake, push = acting.get("vibration"), acting.get("external_push")
    stop, schedule = acting.get("end_stop"), acting.get("gain_schedule")
    most = 0.5 * servo.stall_Nm / servo.kp
    seen, error, integral = 0.0, 0.0, 0.0
    q, v = data.qpos, data.qvel
    two = model.nq > 1 and "backlash" in acting
    out = np.empty(steps)
    for k in range(steps):
        angle, speed = float(q[0]), float(v[0])
        out[k] = angle + float(q[1]) if two else angle
        if k % turn == 0:
            seen = angle
        if k % turn == 0 or at_once:
            error = target[k] - seen
            if dead:
                error = max(abs(error) - dead, 0.0) * (1.0 if error > 0 else -1.0)
            if schedule and abs(error) > schedule["schedule_rad"]:
                beyond = abs(error) - schedule["schedule_rad"]
                size = schedule["schedule_rad"] + schedule["schedule_factor"] * beyond
                error = size if error > 0 else -size
        if integral_rate:
            integral = min(max(integral + integral_rate * error * step, -most), most)
        data.ctrl[0] = error + integral
        extra = ripple * sin(waves * angle + phase)
        if weight:
            extra -= weight * sin(angle)
        if drag:
            extra -= drag * speed * abs(speed)
        if cogging:
            turned = 2 * np.pi * angle / cogging["period_rad"] + cogging["phase_rad"]
            extra += cogging["torque_Nm"] * sin(turned)
        if shake:
            wave = 2 * np.pi * shake["shake_Hz"] * k * step + shake["shake_phase"]
            extra += shake["shake_Nm"] * sin(wave)
        if push:
            edge = max(
                ((1 / (1 + exp(-(k * step - a) / 0.03))) * (1 / (1 + exp((k * step - b) / 0.03)))
                 for a, b in windows if a - 0.5 < k * step < b + 0.5), default=0.0,
            )  # fmt: skip
            extra += push["push_Nm"] * edge
        if stop:
            beyond = stop["stop_side"] * angle - stop["stop_rad"]
            if beyond > 0:
                extra -= stop["stop_side"] * stop["stop_Nm_per_rad"] * beyond
        data.qfrc_applied[0] = extra
        mujoco.mj_step(model, data)
    return np.interp(grid, np.arange(steps) * step, out)
