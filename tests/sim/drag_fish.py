"""Films of a made-up fish: prescribed joints, drag known, dynamics of its own.

Three rigid rods in a plane. Water that goes along across each rod, drag along and across it at its
middle; momentum changes by the drag, nothing else. No line is shared with the twin.
"""

import numpy as np

from sim2real.robot import Joint, Link, Robot, Servo

PERIOD_S, FINE_S = 0.02, 0.004
LENGTH = np.array([0.30, 0.15, 0.10])
MASS = np.array([1.2, 0.1, 0.05])
CARRIED = np.array([1.0, 0.9, 0.8])
ACROSS = np.array([8.0, 8.0, 8.0])
ALONG = np.array([3.0, 0.0, 0.0])
ROBOT = Robot(
    "rods",
    (
        Link("head", 1.2, 0.30, 0.07, 0.10, com_m=0.15),
        Link("tail", 0.1, 0.15, 0.02, 0.10, com_m=0.075),
        Link("fin", 0.05, 0.10, 0.01, 0.10, com_m=0.05),
    ),
    tuple(Joint(f"j{k}", Servo("none", 5.0, 20.0, 0.001), (-1.4, 1.4)) for k in (1, 2)),
)


def angles(t, beat_hz):
    """A wave that runs down the tail, shape (..., 2)."""
    phase = 2 * np.pi * beat_hz * np.asarray(t)[..., None] - [0.0, 1.4]
    return [0.35, 0.45] * np.sin(phase)


def middles(pose, bend):
    """Middles of the rods and their headings, from the head's middle and heading."""
    heading = pose[2] + np.array([0.0, bend[0], bend[0] + bend[1]])
    axis = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    joint = pose[:2] - axis[0] * LENGTH[0] / 2
    at = [pose[:2]]
    for k in (1, 2):
        at.append(joint - axis[k] * LENGTH[k] / 2)
        joint = joint - axis[k] * LENGTH[k]
    return np.array(at), heading


def swum(beat_hz, seconds, before_s):
    """Poses of the head's middle every 20 ms from the film's begin, shape (T, 3)."""
    pose, speed, poses = np.zeros(3), np.array([0.1, 0.0, 0.0]), []
    momentum = None
    for n in range(round((before_s + seconds) / FINE_S)):
        t = n * FINE_S - before_s
        bend = angles(t, beat_hz)
        rate = (angles(t + 1e-5, beat_hz) - angles(t - 1e-5, beat_hz)) / 2e-5
        at, heading = middles(pose, bend)
        moved, _ = middles(pose, bend + 1e-6 * rate)
        own = (moved - at) / 1e-6
        turning = np.array([0.0, rate[0], rate[0] + rate[1]])
        arm = at - pose[:2]
        across = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        # Momentum and spin about the head's middle are linear in its velocity: P = M speed + own.
        matrix, carried = np.zeros((3, 3)), np.zeros(3)
        for k in range(3):
            jacobian = np.array([[1, 0, -arm[k, 1]], [0, 1, arm[k, 0]]])
            tensor = MASS[k] * np.eye(2) + CARRIED[k] * np.outer(across[k], across[k])
            spin = (MASS[k] + CARRIED[k]) * LENGTH[k] ** 2 / 12
            matrix += jacobian.T @ tensor @ jacobian
            matrix[2, 2] += spin
            carried += jacobian.T @ tensor @ own[k] + [0, 0, spin * turning[k]]
        if momentum is not None:  # about the origin, back to the head's middle
            about = momentum - [0, 0, pose[0] * momentum[1] - pose[1] * momentum[0]]
            speed = np.linalg.solve(matrix, about - carried)
        now = matrix @ speed + carried
        if n % round(PERIOD_S / FINE_S) == 0 and t > -FINE_S / 2:
            poses.append(pose.copy())
        force = np.zeros(3)
        for k in range(3):
            v = speed[:2] + speed[2] * np.array([-arm[k, 1], arm[k, 0]]) + own[k]
            u, w = along[k] @ v, across[k] @ v
            push = -ALONG[k] * abs(u) * u * along[k] - ACROSS[k] * abs(w) * w * across[k]
            turn = speed[2] + turning[k]
            damp = -ACROSS[k] * LENGTH[k] ** 3 / 32 * abs(turn) * turn
            force += [*push, arm[k, 0] * push[1] - arm[k, 1] * push[0] + damp]
        momentum = now + FINE_S * force
        momentum[2] += pose[0] * momentum[1] - pose[1] * momentum[0]
        pose = pose + FINE_S * speed
    return np.array(poses)
