"""A bench: three servos follow steps for 30 s at 50 Hz, with jitter, a gap and lost samples."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lsim

from sim2real.model import JointModel, Model
from sim2real.recording import Load, Recording

JOINTS = ("j1", "j2", "j3")
INERTIA = 0.002
LATENCY_S = 0.066


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


def follow(t, command, kp, kd, latency_s):
    """Position of a second-order servo on ``command (T,)``."""
    fine = np.arange(0, t[-1] + 0.002, 0.002)
    delayed = command[(np.searchsorted(t, fine - latency_s, side="right") - 1).clip(min=0)]
    system = ([kp], [INERTIA, kd, kp])
    _, y, _ = lsim(system, delayed - command[0], fine)
    return command[0] + np.interp(t, fine, y)


def make_bench(joints=JOINTS, seed=1):
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.full(1500, 0.02) + rng.normal(0, 0.0008, 1500).clip(-0.004, 0.004))
    t -= t[0]
    t = np.delete(t, slice(640, 655))
    held = t > 22
    command = np.zeros((t.size, len(joints)))
    position, predicted = command.copy(), command.copy()
    for j in range(len(joints)):
        moves = np.cumsum(rng.uniform(0.7, 2.0, 40)) + 0.5
        levels = np.concatenate([[0.0], rng.uniform(-0.7, 0.7, 40)])
        command[:, j] = levels[np.searchsorted(moves, t, side="right")]
        kp, kd = 2.2 - 0.4 * j, 0.060 - 0.005 * j
        truth = follow(t, command[:, j], kp, kd, LATENCY_S + 0.004 * j)
        noisy = truth + rng.normal(0, 0.0015, t.size)
        position[:, j] = np.round(noisy / 0.00419) * 0.00419
        predicted[:, j] = follow(t, command[:, j], 1.04 * kp, 1.02 * kd, LATENCY_S + 0.005 * j)
    position[300:312, 0] = np.nan
    position[rng.random(t.size) < 0.01, -1] = np.nan
    recording = Recording("bench_steps", "servo", tuple(joints), t, command, position)
    model = Model({name: _joint(k) for k, name in enumerate(joints)}, fit=_fit(joints))
    return Bench(recording, model, predicted, held)


def _joint(index):
    load = Load(INERTIA)
    if index == 1:
        return JointModel(
            kp_Nm_per_rad=1.806,
            kd_Nms_per_rad=0.0551,
            latency_s=0.0702,
            inertia_kgm2=INERTIA,
            load=load,
            interval={
                "kp_Nm_per_rad": (1.62, math.inf),
                "kd_Nms_per_rad": (0.0467, 0.0812),
                "latency_s": (0.0661, 0.0738),
            },
            correlation={"kp_Nm_per_rad, kd_Nms_per_rad": 0.94, "kd_Nms_per_rad, latency_s": -0.52},
            notes=(
                "Every step is smaller than 0.05 rad, so kp has no upper bound: record steps of at "
                "least 0.2 rad, or hang a known load on the shaft and hold it level.",
            ),
        )
    return JointModel(
        kp_Nm_per_rad=2.204 - 0.4 * index,
        kd_Nms_per_rad=0.0601 - 0.005 * index,
        latency_s=0.066 + 0.004 * index,
        inertia_kgm2=INERTIA,
        load=load,
        interval={
            "kp_Nm_per_rad": (2.110 - 0.4 * index, 2.298 - 0.4 * index),
            "kd_Nms_per_rad": (0.0563 - 0.005 * index, 0.0640 - 0.005 * index),
            "latency_s": (0.0643 + 0.004 * index, 0.0677 + 0.004 * index),
        },
        correlation={"kp_Nm_per_rad, kd_Nms_per_rad": 0.83, "kp_Nm_per_rad, latency_s": 0.12},
    )


def _fit(joints):
    figures = {"train": 0.0041, "heldout": 0.0043, "noise": 0.0019}
    more = {"correlation_time_s": 0.035, "whiteness": 0.43, "robust_outliers": 0.006}
    return {
        f"{name}.position_rad": figures | (more if k == 0 else {}) for k, name in enumerate(joints)
    }


@pytest.fixture(scope="session")
def bench():
    return make_bench()
