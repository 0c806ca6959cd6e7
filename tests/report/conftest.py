"""A bench: three servos follow steps for 30 s at 50 Hz, with jitter, a gap and lost samples."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from sim2real.model import JointModel, Model
from sim2real.recording import Load, Recording
from sim2real.report.series import fit_figure

JOINTS = ("j1", "j2", "j3")
NOTE = (
    "Every step is smaller than 0.05 rad, so kp has no upper bound: record steps of at least "
    "0.2 rad, or hang a known load on the shaft and hold it level."
)


@dataclass(frozen=True)
class Bench:
    recording: Recording
    model: Model
    predicted: np.ndarray  # (T, J)
    heldout: np.ndarray  # (T,)

    @property
    def fits(self):
        columns = enumerate(self.recording.joints)
        return [(self.recording, j, self.predicted[:, k], self.heldout) for k, j in columns]

    def figure(self):
        """The fit of the first joint, with the noise of its sensor."""
        recording, joint, predicted, heldout = self.fits[0]
        return fit_figure(recording, joint, predicted, heldout=heldout, noise_rad=0.0019)


def follow(t, moves, levels, rate):
    """Angles that approach each level from the time of its move."""
    angle = np.full(t.size, levels[0])
    for move, before, after in zip(moves, levels, levels[1:], strict=False):
        angle += (after - before) * -np.expm1(-rate * (t - move).clip(min=0))
    return angle


@pytest.fixture(scope="session")
def bench():
    rng = np.random.default_rng(1)
    t = np.cumsum(np.full(1500, 0.02) + rng.normal(0, 0.0008, 1500).clip(-0.004, 0.004))
    t = np.delete(t - t[0], slice(640, 655))
    command, position, predicted = np.zeros((3, t.size, len(JOINTS)))
    for j in range(len(JOINTS)):
        moves = np.cumsum(rng.uniform(0.7, 2.0, 40)) + 0.5
        levels = np.concatenate([[0.0], rng.uniform(-0.7, 0.7, 40)])
        command[:, j] = levels[np.searchsorted(moves, t, side="right")]
        noisy = follow(t, moves + 0.07, levels, 20.0) + rng.normal(0, 0.0015, t.size)
        position[:, j] = np.round(noisy / 0.00419) * 0.00419
        predicted[:, j] = follow(t, moves + 0.07, levels, 20.4)
    position[300:312, 0] = np.nan
    position[rng.random(t.size) < 0.01, -1] = np.nan
    recording = Recording("bench_steps", "servo", JOINTS, t, command, position)
    figures = {"train": 0.0041, "heldout": 0.0043, "noise": 0.0019}
    more = {"correlation_time_s": 0.035, "whiteness": 0.43, "robust_outliers": 0.006}
    fit = {f"{name}.position_rad": figures for name in JOINTS}
    fit["j1.position_rad"] = figures | more
    model = Model({name: joint(k) for k, name in enumerate(JOINTS)}, fit=fit)
    return Bench(recording, model, predicted, t > 22)


def joint(index):
    kp, kd, latency_s = 2.204 - 0.4 * index, 0.0601 - 0.005 * index, 0.066 + 0.004 * index
    interval = {
        "kp_Nm_per_rad": (kp - 0.094, kp + 0.094),
        "kd_Nms_per_rad": (kd - 0.0038, kd + 0.0039),
        "latency_s": (latency_s - 0.0017, latency_s + 0.0017),
    }
    correlation = {"kp_Nm_per_rad, kd_Nms_per_rad": 0.83, "kp_Nm_per_rad, latency_s": 0.12}
    one = JointModel(kp, kd, latency_s, 0.002, load=Load(0.002), interval=interval,
                     correlation=correlation)  # fmt: skip
    if index != 1:
        return one
    unbounded = interval | {"kp_Nm_per_rad": (1.62, math.inf)}
    return replace(one, interval=unbounded, notes=(NOTE,))
