"""The arms of the ablation: which techniques each of them uses, and what stands in for the others.

Lin, Liu, Wang, Sec. IV-D: a technique that is left out leaves the old simulator's default. Where
that simulator has none for a robot like this one, what stands in is said here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rl.make import draws_of
from rl.randomize import noise_of, with_density
from rl.sac.train import Arm
from rl.world import Draws
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

EFFORT_NM = 2.0
"""Torque that the old simulator's joints are limited to."""
STIFF = JointModel(
    kp_Nm_per_rad=10.0,
    kd_Nms_per_rad=0.2,
    latency_s=0.0,
    inertia_kgm2=0.002,
    effects=(FittedEffect("torque_saturation", {"limit_Nm": EFFORT_NM}),),
)
"""An uncalibrated servo. The old simulator drives joints by torque; the task commands angles, so
what is left is a stiff drive that asks for the whole effort at an error of 0.2 rad, at once."""


@dataclass(frozen=True)
class Techniques:
    """Switches of one configuration.

    Attributes:
        servo: Gains and latency as identified, else ``STIFF``.
        density: Normalised density as weighed, else one density throughout.
        randomization: Episodes drawn from the ranges, else all from the one model.
        effects: What the diagnosis found, put into the model.
    """

    servo: bool = True
    density: bool = True
    randomization: bool = True
    effects: bool = False


ARMS: Mapping[str, Techniques] = {
    "all": Techniques(),
    "no-servo": Techniques(servo=False),
    "no-density": Techniques(density=False),
    "no-randomization": Techniques(randomization=False),
    "all-and-effects": Techniques(effects=True),
    "ceiling": Techniques(),
    "none": Techniques(servo=False, density=False, randomization=False),
    "midway": Techniques(),
}
"""The paper's four, one that the paper could not have, and the intervention: an arm that learns in
reality's own parameters, where a model says what they are. What it does better than "all", no
technique that was left out can explain away. Left out unless asked for: "none", and "midway", whose
servos and densities lie half way between those of "all" and "none". Arms can go on from its agents:
none is nearer to where they begin, none has met there the servos that another arm lacks, and what
it costs to learn to swim, and when an agent does by chance, is no part of what is compared."""
PAPER = ("all", "no-servo", "no-density", "no-randomization")
TITLES: Mapping[str, str] = {
    "all": "all techniques",
    "no-servo": "no servo calibration",
    "no-density": "no density calibration",
    "no-randomization": "no randomization",
    "all-and-effects": "all, and the effects found",
    "ceiling": "trained in reality itself",
    "none": "no technique",
    "midway": "half way from no technique",
}


def one_density(robot: Robot) -> list[float]:
    """Normalised densities of links of one material, by the volumes of elliptic cylinders.

    The old simulator gives every link 1080 kg/m3. Mass that floats is what the pool's robot has, so
    the total stays and only its share changes.
    """
    section = np.array([link.width_m * link.height_m for link in robot.links])
    length = np.array([link.length_m for link in robot.links])
    return [float(x) for x in section * length.sum() / (section * length).sum()]


def model_of(
    techniques: Techniques, model: Model, robot: Robot, enriched: Model | None = None
) -> Model:
    """The simulator that an arm trains in.

    Args:
        techniques: Its switches.
        model: The calibrated model.
        robot: The robot.
        enriched: The model with what the diagnosis found; the calibrated one where None.
    """
    chosen = with_density(enriched if techniques.effects and enriched else model, robot)
    if not techniques.density:
        chosen = replace(chosen, body={**chosen.body, "normalised_density": one_density(robot)})
    if not techniques.servo:
        chosen = replace(chosen, joints=dict.fromkeys(chosen.joints, STIFF))
    return chosen


def arm_of(
    name: str,
    model: Model,
    robot: Robot,
    ranges: Ranges,
    enriched: Model | None = None,
    reality: Model | None = None,
) -> Arm:
    """An arm to train.

    A range of a technique that is off is left out, or it would bring the technique back.

    Args:
        name: One of ``ARMS``.
        model: The calibrated model.
        robot: The robot.
        ranges: What is randomized.
        enriched: The model with what the diagnosis found.
        reality: Reality's own parameters, for the arm "ceiling".
    """
    techniques = ARMS[name]
    if name == "midway":
        drawn, old = arm_of("all", model, robot, ranges).draws, model_of(ARMS["none"], model, robot)
        models = tuple(half_way(one, old) for one in drawn.models)
        return Arm(name, replace(drawn, models=models))
    if name == "ceiling":
        assert reality is not None, "the caller has looked"
        noise = noise_of(ranges, [joint.name for joint in robot.joints])
        return Arm(name, Draws((with_density(reality, robot),), noise))
    own = model_of(techniques, model, robot, enriched)
    if not techniques.randomization:
        return Arm(name, draws_of(own, None, robot, seed=0))
    joints = set(model.joints)

    def kept(parameter: str) -> bool:
        servo = parameter.split(".")[0] in joints and not parameter.endswith("position_noise_rad")
        if not techniques.servo and (servo or parameter == "command_latency_s"):
            return False
        return techniques.density or not parameter.startswith("body.normalised_density")

    entries = tuple(entry for entry in ranges.entries if kept(entry.parameter))
    return Arm(name, draws_of(own, replace(ranges, entries=entries), robot, seed=0))


def half_way(one: Model, other: Model) -> Model:
    """A model with gains, latencies and densities between two: geometric means of the gains."""
    joints = {}
    for name, a in one.joints.items():
        b = other.joints[name]
        joints[name] = replace(
            a,
            kp_Nm_per_rad=(a.kp_Nm_per_rad * b.kp_Nm_per_rad) ** 0.5,
            kd_Nms_per_rad=(a.kd_Nms_per_rad * b.kd_Nms_per_rad) ** 0.5,
            latency_s=(a.latency_s + b.latency_s) / 2,
        )
    density = np.mean([m.body["normalised_density"] for m in (one, other)], axis=0)
    body = {**one.body, "normalised_density": [float(x) for x in density]}
    return replace(one, joints=joints, body=body)
