"""A three-joint fish and its servos, for tests."""

from dataclasses import replace

import numpy as np
import warp as wp

from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.kernel import start_twin
from sim2real.body import listed
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.robot import Joint, Link, Robot, Servo

SERVO = Servo("lx824", 1.67, 5.24, 0.00419)
FISH = Robot(
    "fish",
    (
        Link("head", 0.52, 0.20, 0.09, 0.12),
        Link("middle", 0.26, 0.11, 0.08, 0.11),
        Link("peduncle", 0.18, 0.10, 0.05, 0.10),
        Link("tail", 0.14, 0.11, 0.02, 0.12),
    ),
    tuple(Joint(f"j{k}", SERVO, (-0.8, 0.8)) for k in (1, 2, 3)),
)


LAW = {
    "across": 4.7, "along": 0.001, "added_mass": 1.236, "thrust": 0.273, "linear": 5.512,
    "slender": 1.66, "head": 0.5077, "axial": 0.5565, "wake": 0.7691, "wake_s": 0.3404,
    "tail": 1.377, "lag": 0.8648,
}  # fmt: skip
"""A twin's law of its own: the fitted one's may change."""


def servos(kp=2.2, kd=0.06, latency=0.068, effects=()):
    """Three servos of one kind, with (effect, parameters) in each."""
    fitted = tuple(FittedEffect(name, values) for name, values in effects)
    joint = JointModel(kp, kd, latency, 0.002, effects=fitted)
    return Model(joints={one.name: joint for one in FISH.joints}, body={"twin": LAW})


def with_effects(**parameters):
    """Servos of a robot whose body has these effects; double underscores stand for dots."""
    named = {name.replace("__", "."): value for name, value in parameters.items()}
    return replace(servos(), body={"effects": listed(named)})


def in_a_box(model=None, **more):
    """The fish in two dimensions, in coarse cells."""
    small = {"dimensions": 2, "cell_m": 0.04, "box_m": (0.9, 0.9, 0.4)}
    return Swimmer(FISH, model or servos(), **{**small, **more})


def beat(swimmer, periods, scale=1.0, first=0):
    """Swim: a wave runs down the joints 1.5 times a second."""
    for k in range(first, first + periods):
        wave = np.sin(2 * np.pi * 1.5 * CONTROL_S * k - 1.2 * np.arange(3))
        swimmer.step(scale * np.array([0.3, 0.45, 0.6]) * wave)


def glide(periods=25, **parameters):
    """What is left in these control periods of 0.3 m/s ahead, of a robot with these effects."""
    swimmer = in_a_box(with_effects(**parameters))
    q, v = swimmer.bodies.motion.q.numpy(), np.zeros((1, 6))
    v[0, 0] = 0.3
    swimmer.bodies.place(q, v)
    for _ in range(periods):
        swimmer.step(np.zeros(3))
    return swimmer.state().velocity[0, 0]


def moving(twin, v, q=None):
    """Give the robots of a twin these velocities (E, 3 + J), and coordinates where given."""
    twin.motion.v.assign(np.array(v))
    if q is not None:
        twin.motion.q.assign(np.array(q))
    everyone = wp.ones(twin.n_envs, dtype=wp.int32)
    inputs = [twin.chain, twin.motion, twin.water, everyone]
    wp.launch(start_twin, dim=twin.n_envs, inputs=inputs)
