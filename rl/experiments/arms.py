"""The arms of the ablation: the techniques of each, and the defaults that replace the others.

Lin, Liu, Wang, Sec. IV-D: without a technique the default of the old simulator is used. Where that
simulator has no default for this robot, one is defined here.
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
"""Torque limit of the joints in the old simulator, N m."""
STIFF = JointModel(
    kp_Nm_per_rad=10.0,
    kd_Nms_per_rad=0.2,
    latency_s=0.0,
    inertia_kgm2=0.002,
    effects=(FittedEffect("torque_saturation", {"limit_Nm": EFFORT_NM}),),
)
"""An uncalibrated servo. The old simulator drives joints by torque; the task commands angles, so
the default is a stiff drive without latency that reaches its torque limit at an error of 0.2
rad."""


@dataclass(frozen=True)
class Techniques:
    """Techniques of an arm: without servo joints are ``STIFF``, without density links are alike.

    Without randomization all episodes have the same model, with effects the diagnosed ones.
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
"""The four arms of the paper; "all-and-effects", with diagnosed effects; and "ceiling", trained
with the true parameters of the reality where they are known: an upper bound. By default not run:
"none", and "midway", whose servos and densities lie half way between those of "all" and "none".
Training of the other arms can continue from agents of "midway": no arm is favoured by that start,
and the time to learn swimming, which differs by chance, is not part of the comparison."""
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
    """Normalised densities of links of one material, with volumes of elliptic cylinders.

    The old simulator gives every link 1080 kg/m3. The robot is neutrally buoyant, so the total mass
    is kept and only its distribution changes.
    """
    section = np.array([link.width_m * link.height_m for link in robot.links])
    length = np.array([link.length_m for link in robot.links])
    return [float(x) for x in section * length.sum() / (section * length).sum()]


def model_of(
    techniques: Techniques, model: Model, robot: Robot, enriched: Model | None = None
) -> Model:
    """The simulator that an arm trains in; ``enriched`` is the model with diagnosed effects."""
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
    """An arm of ``ARMS`` to train; "ceiling" needs the true parameters of the reality.

    Ranges of a technique that the arm does not use are omitted, as they contain its results.
    """
    techniques = ARMS[name]
    if name == "midway":
        drawn, old = arm_of("all", model, robot, ranges).draws, model_of(ARMS["none"], model, robot)
        models = tuple(half_way(m, old) for m in drawn.models)
        return Arm(name, replace(drawn, models=models))
    if name == "ceiling":
        assert reality is not None, "the caller has looked"
        noise = noise_of(ranges, [joint.name for joint in robot.joints])
        return Arm(name, Draws((with_density(reality, robot),), noise))
    arm_model = model_of(techniques, model, robot, enriched)
    if not techniques.randomization:
        return Arm(name, draws_of(arm_model, None, robot, seed=0))
    joints = set(model.joints)

    def used(parameter: str) -> bool:
        servo = parameter.split(".")[0] in joints and not parameter.endswith("position_noise_rad")
        if not techniques.servo and (servo or parameter == "command_latency_s"):
            return False
        return techniques.density or not parameter.startswith("body.normalised_density")

    entries = tuple(entry for entry in ranges.entries if used(entry.parameter))
    return Arm(name, draws_of(arm_model, replace(ranges, entries=entries), robot, seed=0))


def half_way(first: Model, second: Model) -> Model:
    """Mean of two models: geometric for gains, arithmetic for latencies and densities."""
    joints = {}
    for name, a in first.joints.items():
        b = second.joints[name]
        joints[name] = replace(
            a,
            kp_Nm_per_rad=(a.kp_Nm_per_rad * b.kp_Nm_per_rad) ** 0.5,
            kd_Nms_per_rad=(a.kd_Nms_per_rad * b.kd_Nms_per_rad) ** 0.5,
            latency_s=(a.latency_s + b.latency_s) / 2,
        )
    density = np.mean([m.body["normalised_density"] for m in (first, second)], axis=0)
    body = {**first.body, "normalised_density": [float(x) for x in density]}
    return replace(first, joints=joints, body=body)
