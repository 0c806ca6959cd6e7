"""A servo that shares no code with the library, and its log as a servo's own tool writes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim2real.arrays import Array

COUNTS, ZERO, INERTIA = 4096, 2048, 0.0021
STEP_S, PERIOD_S = 2e-4, 0.01


@dataclass(frozen=True)
class Servo:
    """PD control behind a delay, a shaft with dry friction, an encoder of 4096 counts and noise."""

    kp: float = 1.4
    kd: float = 0.05
    delay_s: float = 0.035
    friction_Nm: float = 0.0
    deadband_rad: float = 0.0
    noise_rad: float = 0.0006

    def run(self, t: Array, goal: Array, rng: np.random.Generator) -> Array:
        """Measured angles in rad at times t (T,) on set-points (T,), by semi-implicit Euler."""
        ticks = np.arange(0.0, t[-1] + STEP_S, STEP_S)
        in_force = goal[np.maximum(np.searchsorted(t + self.delay_s, ticks, "right") - 1, 0)]
        q = v = 0.0
        angle = np.empty(ticks.size)
        slowed = STEP_S * self.friction_Nm / INERTIA
        for k, u in enumerate(in_force.tolist()):
            angle[k] = q
            error = u - q
            error -= min(max(error, -self.deadband_rad), self.deadband_rad)
            v += STEP_S * (self.kp * error - self.kd * v) / INERTIA
            v = 0.0 if abs(v) < slowed else v - np.sign(v) * slowed
            q += STEP_S * v
        return np.interp(t, ticks, angle) + rng.normal(0, self.noise_rad, t.size)


def commands(kind: str, t: Array, rng: np.random.Generator) -> Array:
    """Set-points in rad that begin with half a second at 0."""
    s = np.maximum(t - 0.5, 0.0)
    if kind == "steps":
        at = 0.5 + np.cumsum(rng.uniform(0.3, 0.8, t.size))
        levels = np.concatenate([[0.0], rng.uniform(-0.6, 0.6, t.size)])
        return levels[np.searchsorted(at, t, side="right")]
    if kind == "triangle":
        wave: Array = (1 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.3 * s))
        return wave
    return np.asarray(0.4 * np.sin(2 * np.pi * (0.1 + 0.1 * s) * s))


def write_log(servo: Servo, kind: str, path: Path, seed: int, seconds: float = 8.0) -> None:
    """``time_ms,goal,present`` with clock jitter, angles in counts."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    t[1:] += rng.uniform(-1e-3, 1e-3, t.size - 1)
    per_count = 2 * np.pi / COUNTS
    goal = np.rint(commands(kind, t, rng) / per_count)
    present = np.rint(servo.run(t, per_count * goal, rng) / per_count)
    rows = zip(1e3 * t + 5000, goal + ZERO, present + ZERO, strict=True)
    lines = ["time_ms,goal,present", *(f"{a:.3f},{b:.0f},{c:.0f}" for a, b, c in rows)]
    path.write_text("\n".join(lines) + "\n")
