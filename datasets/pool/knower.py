"""What one who knows the plant, its numbers and its noise can tell from a swim.

The water of another box, in which nothing is concealed, is swum beside each case: the difference of
their signals is what is concealed, and what turbulence nobody can foretell. Its log-likelihood
ratio counts the camera's and the joints' noise, a share of turbulence, and what gains and latencies
within the bench's error would imitate: those directions are the library's twin's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from camera import NOISE, STEP_RAD
from drawn import Case, Drawn
from numpy.typing import NDArray

from sim.inference.swims import by_twin, with_values
from sim2real.model import Model
from sim2real.velocity import body_velocity

Array = NDArray[np.float64]

GAIN, LATE_S = 0.03, 0.0025
"""What a bench is off by: of kp and kd, and in seconds (one sd)."""
TURBULENT = (0.008, 0.004, 0.04)
"""What another wake changes of surge, sway (m/s) and yaw rate (rad/s), for some 0.4 s. With these,
two boxes in which nothing is concealed seldom differ by more than what counts as detectable."""
TURBULENT_RAD = 0.004
"""The same of a joint's angle."""
LASTS = (12.0, 20.0)
"""Samples that the camera's noise lasts in speeds of a window, and turbulence."""


def known_to(
    t: Array, pose: Array, joint: Array, plain: Array, plain_joint: Array, sent: Array,
    case: Case, drawn: Drawn, model: Model, unknown: Sequence[Array] = (),
) -> dict[str, Any]:  # fmt: skip
    """Log-likelihood ratio, and how far what is concealed moves each signal.

    Args:
        t: Times in s, shape (T,).
        pose: As the camera shows it but for noise, shape (T, 3).
        joint: Joint angles, shape (T, J).
        plain: Poses of a swim in which nothing is concealed.
        plain_joint: Its joint angles.
        sent: Set-points, shape (T, J).
        case: What is concealed.
        drawn: The robot.
        model: What a bench gives.
        unknown: Changes of all signals, each (T, 3 + J), whose sizes are not known either.
    """
    shown, without = body_velocity(t, pose), body_velocity(t, plain)
    rng = np.random.default_rng(0)
    drawn_noise = rng.standard_normal((t.size, 3)) * [
        case.camera["position_m"], case.camera["position_m"], case.camera["heading_rad"]
    ]  # fmt: skip
    noise = body_velocity(t, drawn_noise).std(axis=0)
    joint_noise = float(np.hypot(NOISE["joint_rad"], STEP_RAD / np.sqrt(12)))
    sd = np.sqrt(noise**2 * LASTS[0] + np.square(TURBULENT) * LASTS[1])
    held = float(np.sqrt(joint_noise**2 + TURBULENT_RAD**2 * LASTS[1]))
    sd = np.concatenate([sd, np.full(joint.shape[1], held)])
    change = np.concatenate([shown - without, joint - plain_joint], axis=1)
    white = (change / sd).ravel()
    nuisance = np.array([*_nuisance(drawn, model, sent, plain[0], t), *unknown]) / sd
    basis = nuisance.reshape(len(nuisance), -1)
    inner = np.eye(len(basis)) + basis @ basis.T
    seen = basis @ white
    llr = 0.5 * float(white @ white - seen @ np.linalg.solve(inner, seen))
    return {
        "llr_total": llr,
        "moves_rms": [float(x) for x in np.sqrt(np.mean(change**2, axis=0))],
        "noise": [*(float(x) for x in noise), *([joint_noise] * joint.shape[1])],
    }


def _nuisance(drawn: Drawn, model: Model, sent: Array, start: Array, t: Array) -> Array:
    """What one sd of each gain and latency moves, by the twin, shape (3 J, T, 3 + J)."""
    steps = {}
    for name, servo in model.joints.items():
        steps[f"{name}.kp_Nm_per_rad"] = GAIN * servo.kp_Nm_per_rad
        steps[f"{name}.kd_Nms_per_rad"] = GAIN * servo.kd_Nms_per_rad
        steps[f"{name}.latency_s"] = LATE_S
    models = [model]
    for name, step in steps.items():
        joint, _, field = name.partition(".")
        models.append(with_values(model, {name: getattr(model.joints[joint], field) + step}))
    robot = replace(drawn.robot, name=drawn.robot.name)
    track = by_twin(robot, threads=1)(models, sent, start)
    signals = np.stack([
        np.concatenate([body_velocity(t, one[:, :3]), one[:, 3:]], axis=1) for one in track
    ])  # fmt: skip
    return np.asarray(signals[1:] - signals[0])


__all__ = ["known_to"]
