"""An oracle that knows the plant, its parameters and its noise.

Each case is simulated once more in another box, without concealed effects: the difference of the
signals is due to them and to unpredictable turbulence. The log-likelihood ratio includes the noise
of camera and joints, an allowance for turbulence, and what errors of gains and latencies within the
accuracy of the bench imitate, by the derivatives of the library's twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from camera import NOISE, STEP_RAD
from drawn import BENCH, BENCH_S, Case, Drawn
from numpy.typing import NDArray

from sim.inference.swims import with_values
from sim.twin.twin import Twin
from sim2real.model import Model
from sim2real.velocity import body_velocity

Array = NDArray[np.float64]

GAIN, LATE_S = BENCH / np.sqrt(3), BENCH_S / np.sqrt(3)
"""Standard deviations of the bench's kp and kd (relative) and latency."""
TURBULENT = (0.008, 0.004, 0.04)
"""Standard deviations of surge, sway (m/s) and yaw rate (rad/s) by another wake, correlated for
about 0.4 s. With these, two boxes without concealed effects seldom differ detectably."""
TURBULENT_RAD = 0.004
"""The same of a joint's angle."""
LASTS = (12.0, 20.0)
"""Correlation lengths, in samples, of the camera's noise in windowed speeds and of turbulence."""


def known_to(
    t: Array, pose: Array, joint: Array, plain: Array, plain_joint: Array, sent: Array,
    case: Case, drawn: Drawn, model: Model, unknown: Sequence[Array] = (),
) -> dict[str, Any]:  # fmt: skip
    """Log-likelihood ratio of the concealed effects, and their size in each signal.

    Args:
        t: Times in s, shape (T,).
        pose: Poses of the camera without noise, shape (T, 3).
        joint: Joint angles, shape (T, J).
        plain: Poses of the swim without concealed effects.
        plain_joint: Its joint angles.
        sent: Set-points, shape (T, J).
        case: The case.
        drawn: The robot.
        model: Identified on a bench.
        unknown: Changes of all signals, each (T, 3 + J), with unknown sizes.
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
    """Changes by one standard deviation of each gain and latency in the twin, (3 J, T, 3 + J)."""
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
    track = Twin(robot, models, n_envs=len(models), threads=1).swum(sent, start)
    signals = np.stack([
        np.concatenate([body_velocity(t, one[:, :3]), one[:, 3:]], axis=1) for one in track
    ])  # fmt: skip
    return np.asarray(signals[1:] - signals[0])
