"""A simulated SO-101, by MuJoCo: what makes recordings of an arm, with all physics known.

It shares no dynamics with ``sim2real``: MuJoCo integrates the bodies, rotors, dry friction and
play in steps of 0.1 ms; each servo's firmware runs at 1 kHz on its quantised encoder, with a
proportional law whose duty cycle is limited by the supply voltage.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco as mj
import numpy as np
from numpy.typing import NDArray

from sim2real.recording import Recording

Array = NDArray[np.float64]
FOLDER = Path(__file__).parent
URDF = FOLDER / "so101.urdf"
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
HOME = np.array([0.0, -0.4, 0.5, 0.2, 0.0, 0.6])
"""Middle of each joint's motion, rad."""
COUNT_RAD = 2 * np.pi / 4096


def _each(*values: float) -> Any:  # noqa: ANN401 - a field
    return field(default_factory=lambda: np.array(values))


@dataclass(frozen=True)
class Physics:
    """Physics of the servos; each array has one value for each of the six joints.

    Attributes:
        kp_Nm_per_rad: Torque per error below the limit of the supply.
        stall_torque_Nm: At full duty cycle.
        no_load_speed_rad_s: At full duty cycle.
        viscous_Nms_per_rad: Friction proportional to speed.
        rotor_inertia_kgm2: Of the rotor and gears, at the output.
        latency_s: From sending a set-point to the firmware's first tick that uses it.
        coulomb_Nm: Dry friction on the motor's side.
        gap_rad: Play between motor and output.
        output_Nm: Dry friction on the output's side of the play.
        encoder_noise_rad: Standard deviation before quantisation.
    """

    kp_Nm_per_rad: Array = _each(17.8, 20, 18.5, 16, 15, 14)
    stall_torque_Nm: Array = _each(2.9, 3.0, 2.85, 2.95, 2.8, 2.9)
    no_load_speed_rad_s: Array = _each(5.0, 4.8, 5.1, 4.9, 5.2, 5.0)
    viscous_Nms_per_rad: Array = _each(0.05, 0.06, 0.04, 0.05, 0.03, 0.04)
    rotor_inertia_kgm2: Array = _each(0.028, 0.03, 0.027, 0.026, 0.028, 0.025)
    latency_s: Array = _each(0.014, 0.017, 0.012, 0.02, 0.016, 0.018)
    coulomb_Nm: Array = _each(*np.zeros(6))
    gap_rad: Array = _each(*np.zeros(6))
    output_Nm: Array = _each(*np.zeros(6))
    encoder_noise_rad: float = 5e-4

    @property
    def kd_Nms_per_rad(self) -> Array:
        """Damping by back-EMF and viscous friction."""
        return self.stall_torque_Nm / self.no_load_speed_rad_s + self.viscous_Nms_per_rad


WORN = Physics(
    coulomb_Nm=np.array([0.06, 0.09, 0.07, 0.05, 0.06, 0.05]),
    gap_rad=np.array([0.012, 0.016, 0.014, 0.012, 0.016, 0.01]),
    output_Nm=np.array([0.015, 0.02, 0.015, 0.01, 0.02, 0.01]),
)
"""Servos with dry friction and play."""


def multisines(t: Array, rng: np.random.Generator, reach: float = 0.45) -> Array:
    """Set-points of six joints: sines from 0.1 to 2 Hz, after a rest of half a second."""
    since = np.maximum(t - 0.5, 0.0)
    frequency = np.geomspace(0.1, 2.0, 9)
    phase = rng.uniform(0, 2 * np.pi, (6, frequency.size))
    angle = 2 * np.pi * since[:, None, None] * frequency + phase
    wave = ((np.sin(angle) - np.sin(phase)) / np.sqrt(frequency)).sum(axis=2)
    return HOME + reach * wave / np.abs(wave).max(axis=0)


def steps(t: Array, rng: np.random.Generator, reach: float = 0.4) -> Array:
    """Set-points of six joints, each stepping at its own times, after a rest of half a second."""
    command = np.empty((t.size, 6))
    for j in range(6):
        times = 0.5 + np.cumsum(np.append(0.0, rng.uniform(0.5, 1.6, t.size)))
        level = np.append(0.0, rng.uniform(-reach, reach, t.size + 1))
        command[:, j] = HOME[j] + level[np.searchsorted(times, t, side="right")]
    return command


def recorded(
    name: str,
    command: Array,
    t: Array,
    physics: Physics,
    rng: np.random.Generator,
    *,
    tick_s: float = 1e-3,
    substeps: int = 10,
) -> tuple[Recording, Array]:
    """Let the arm follow commands, and record it.

    Args:
        name: Name of the recording.
        command: Set-points in rad sent at ``t``, shape (T, 6).
        t: Times in s, shape (T,), multiples of ``tick_s``.
        physics: Physics of the servos.
        rng: Generator of the encoders' noise.
        tick_s: Period of the firmware.
        substeps: Steps of the integration in one period.

    Returns:
        The recording, and the true angles of the outputs in rad, shape (T, 6).
    """
    model, motor, play = _compiled(physics, tick_s / substeps)
    data = mj.MjData(model)
    data.qpos[motor] = command[0]
    command = COUNT_RAD * np.round(command / COUNT_RAD)
    settle = round(2.0 / tick_s)  # at rest on the first set-point
    arrival = np.round((t[:, None] + physics.latency_s) / tick_s).astype(int)
    sample = np.round(t / tick_s).astype(int)
    measured, true, row = np.empty((t.size, 6)), np.empty((t.size, 6)), 0
    newest = np.zeros(6, dtype=int)
    for tick in range(-settle, sample[-1] + 1):
        output = data.qpos[motor] + (data.qpos[play] if play.size else 0.0)
        if row < t.size and sample[row] == tick:
            true[row] = output
            measured[row] = _read(output, physics, rng)
            row += 1
        for j in range(6):
            while newest[j] + 1 < t.size and arrival[newest[j] + 1, j] <= tick:
                newest[j] += 1
        target = command[newest, np.arange(6)]
        error = target - _read(data.qpos[motor], physics, rng)
        duty = np.clip(physics.kp_Nm_per_rad * error / physics.stall_torque_Nm, -1, 1)
        data.ctrl[:] = duty * physics.stall_torque_Nm
        mj.mj_step(model, data, nstep=substeps)
    source = "Simulated SO-101 (MuJoCo); URDF by TheRobotStudio, Apache-2.0."
    recording = Recording(name, "servo", NAMES, t, command, measured, source=source)
    return recording, true


def _read(angle: Array, physics: Physics, rng: np.random.Generator) -> Array:
    noisy = angle + rng.normal(0, physics.encoder_noise_rad, angle.shape)
    return np.asarray(COUNT_RAD * np.round(noisy / COUNT_RAD))


def _compiled(physics: Physics, step_s: float) -> tuple[Any, Any, Any]:
    """MuJoCo's model, and the places of the motors' and of the play's angles."""
    spec: Any = mj.MjSpec.from_file(str(URDF))
    spec.option.timestep = step_s
    spec.option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mj.mjtDisableBit.mjDSBL_CONTACT
    for j, name in enumerate(NAMES):
        joint = spec.joint(name)
        joint.limited = False
        joint.armature = physics.rotor_inertia_kgm2[j]
        emf = physics.stall_torque_Nm[j] / physics.no_load_speed_rad_s[j]
        _set_damping(joint, emf + physics.viscous_Nms_per_rad[j])
        joint.frictionloss = physics.coulomb_Nm[j]
        joint.solref_friction = [0.0005, 1.0]
        joint.solimp_friction = [0.999, 0.9999, 0.001, 0.5, 2]
        joint.actfrclimited = False
        actuator = spec.add_actuator(name=name, target=name)
        actuator.trntype = mj.mjtTrn.mjTRN_JOINT
        actuator.set_to_motor()
        if physics.gap_rad[j] > 0:
            gap = physics.gap_rad[j] / 2
            added = joint.parent.add_joint(
                name=f"{name}_play", type=mj.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=joint.pos
            )
            added.range, added.limited = [-gap, gap], True
            output = spec.add_tendon(name=f"{name}_output", frictionloss=physics.output_Nm[j])
            output.wrap_joint(name, 1.0)
            output.wrap_joint(f"{name}_play", 1.0)
            output.solref_friction = joint.solref_friction
            output.solimp_friction = joint.solimp_friction
            added.solref_limit, added.solimp_limit = [0.001, 1.0], [0.99, 0.999, 1e-4, 0.5, 2]
    model = spec.compile()
    motor = np.array([model.joint(name).qposadr[0] for name in NAMES])
    loose = [name for name, gap in zip(NAMES, physics.gap_rad, strict=True) if gap > 0]
    play = [model.joint(f"{name}_play").qposadr[0] for name in loose]
    return model, motor, np.array(play, dtype=int)


def _set_damping(joint: Any, value: float) -> None:
    """Set the linear damping of a joint, which some versions of MuJoCo hold in an array."""
    try:
        joint.damping = value
    except (TypeError, ValueError):
        damping = np.zeros_like(np.asarray(joint.damping))
        damping[0] = value
        joint.damping = damping
