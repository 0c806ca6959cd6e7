"""What camera and servos show: poses and angles with noise, angles in the servo's steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

NOISE = {"position_m": 0.002, "heading_rad": 0.009, "joint_rad": 0.0015}
STEP_RAD = 0.00419


def filmed(pose: Array, rng: np.random.Generator, noise: dict[str, float] = NOISE) -> Array:
    """Poses as an overhead camera shows them, shape (n, 3)."""
    shown = pose.copy()
    shown[:, :2] += noise["position_m"] * rng.standard_normal((len(pose), 2))
    shown[:, 2] += noise["heading_rad"] * rng.standard_normal(len(pose))
    return shown


def reported(angle: Array, rng: np.random.Generator) -> Array:
    """Angles as the servos report them, shape (n, J)."""
    noisy = angle + NOISE["joint_rad"] * rng.standard_normal(angle.shape)
    return np.asarray(np.round(noisy / STEP_RAD) * STEP_RAD)


def seen(
    t: Array,
    pose: Array,
    joint: Array,
    effects: Effects,
    rng: np.random.Generator,
    noise: dict[str, float] | None = None,
) -> Array:
    """Poses (T, 3) as a camera with its faults shows them.

    In this order: where the marker sits, that it is late, noise, that frames are lost and repeat
    what was shown last, that it smooths, how it is mounted and how long its metre is.

    Args:
        t: Times in s, shape (T,), even.
        pose: Of the head, shape (T, 3).
        joint: Joint angles, shape (T, J).
        effects: What is concealed.
        rng: Which frames are lost, and the noise.
        noise: Of the poses, ``position_m`` and ``heading_rad``; none where None.
    """

    def of(effect: str, name: str) -> float:
        return effects.get(effect, {}).get(name, 0.0)

    shown = pose.copy()
    if "bending_marker" in effects:
        bend = of("bending_marker", "share") * joint[:, 0]
        shown[:, :2] -= of("bending_marker", "arm_m") * _turned(shown[:, 2], bend)
        shown[:, 2] += bend
    off = np.array([of("marker_offset", "x_m"), of("marker_offset", "y_m")])
    c, s = np.cos(shown[:, 2]), np.sin(shown[:, 2])
    shown[:, 0] += c * off[0] - s * off[1]
    shown[:, 1] += s * off[0] + c * off[1]
    late = of("camera_latency", "latency_s")
    shown = np.stack([np.interp(t - late, t, column) for column in shown.T], axis=1)
    lost = rng.random(t.size) < of("dropped_frames", "probability")
    lost[0] = False
    if noise is not None:
        shown = filmed(shown, rng, noise)
    shown = shown[np.maximum.accumulate(np.where(lost, 0, np.arange(t.size)))]
    time = of("pose_filter", "time_constant_s")
    if time > 0:
        share = 1 - np.exp(-(t[1] - t[0]) / time)
        for k in range(1, t.size):
            shown[k] = shown[k - 1] + share * (shown[k] - shown[k - 1])
    angle = of("camera_rotation", "angle_rad") + of("drifting_mount", "rad_per_s") * t
    x, y = shown[:, 0].copy(), shown[:, 1].copy()
    shown[:, 0] = np.cos(angle) * x - np.sin(angle) * y + of("drifting_mount", "x_m_s") * t
    shown[:, 1] = np.sin(angle) * x + np.cos(angle) * y + of("drifting_mount", "y_m_s") * t
    shown[:, 2] += of("drifting_mount", "rad_per_s") * t
    shown[:, :2] *= 1 + of("camera_scale", "ratio")
    return shown


def _turned(heading: Array, bend: Array) -> Array:
    """How a rod's end moves as its root bends, per length: shape (T, 2)."""
    one = np.stack([np.cos(heading + bend), np.sin(heading + bend)], axis=1)
    return np.asarray(one - np.stack([np.cos(heading), np.sin(heading)], axis=1))
