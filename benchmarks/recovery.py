"""Recover the parameters of many simulated servos, and count how often the intervals hold.

    python benchmarks/recovery.py --servos 200 --seed 1

Each servo has its own gains (natural frequency 10 to 60 rad/s, damping ratio 0.3 to 1.2), latency
(20 to 120 ms) and 30 s of random steps at 50 Hz with jittered times, 1.5 mrad of noise and 0.24
degree steps. The motion is computed by matrix exponentials between events and shares nothing with
the library.
"""

from __future__ import annotations

import numpy as np
from harness import command_line, spread
from scipy.linalg import expm

from sim2real.arrays import Array

NAMES = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
INERTIA_KGM2 = 0.002
STEP_RAD, NOISE_RAD = np.deg2rad(0.24), 0.0015


def motion(truth: Array, t: Array, command: Array) -> Array:
    """Exact angle of a PD servo from rest, shape (T,)."""
    kp, kd, latency = truth
    arrival = t + latency
    times = np.union1d(t, arrival)
    held = command[np.maximum(np.searchsorted(arrival, times, side="right") - 1, 0)]
    A = np.array([[0.0, 1.0], [-kp, -kd]] / np.array([[1.0], [INERTIA_KGM2]]))
    state, angle = np.array([held[0], 0.0]), np.empty(times.size)
    angle[0] = state[0]
    for k, propagator in enumerate(expm(A * np.diff(times)[:, None, None])):
        rest = np.array([held[k], 0.0])
        state = rest + propagator @ (state - rest)
        angle[k + 1] = state[0]
    return angle[np.searchsorted(times, t)]


def recover(seed: int) -> tuple[Array, Array, Array]:
    """Truth, estimate and 90 % interval (3, 2) of one servo."""
    from sim2real.identification.identify import identify
    from sim2real.recording import Load, Recording
    from sim2real.robot import Joint, Link, Robot, Servo

    rng = np.random.default_rng(seed)
    frequency, damping = np.exp(rng.uniform(np.log(10), np.log(60))), rng.uniform(0.3, 1.2)
    kp = frequency**2 * INERTIA_KGM2
    truth = np.array([kp, 2 * damping * frequency * INERTIA_KGM2, rng.uniform(0.02, 0.12)])
    t = np.arange(0.0, 30.0, 0.02)
    t = t + rng.normal(0.0, 3e-4, t.size)
    changes = 0.5 + np.cumsum(rng.uniform(0.4, 1.5, 100))
    command = np.append(0.0, rng.uniform(-0.6, 0.6, 100))[np.searchsorted(changes, t)]
    noisy = motion(truth, t, command) + rng.normal(0.0, NOISE_RAD, t.size)
    recording = Recording(
        name="steps",
        kind="servo",
        joints=("j1",),
        t=t,
        command=command[:, None],
        position=np.round(noisy / STEP_RAD)[:, None] * STEP_RAD,
        loads={"j1": Load(INERTIA_KGM2)},
    )
    link = Link("link", 1.0, 0.1, 0.1, 0.1)
    joint = Joint("j1", Servo("servo", 10.0, 100.0, STEP_RAD), (-1.0, 1.0))
    model = identify([recording], Robot("bench", (link, link), (joint,))).joints["j1"]
    estimate = np.array([getattr(model, name) for name in NAMES])
    return truth, estimate, np.array([model.interval[name] for name in NAMES])


def main() -> None:
    """Print the table."""
    options = command_line(__doc__, servos=200, seed=1, workers=2).parse_args()
    seeds = range(1000 * options.seed, 1000 * options.seed + options.servos)
    results = list(spread(recover, seeds, options.workers, unit="servo"))
    truth, estimate, interval = (np.array(x) for x in zip(*results, strict=True))
    error = np.abs(estimate - truth)
    covered = (interval[..., 0] <= truth) & (truth <= interval[..., 1])
    print(f"{options.servos} servos, {INERTIA_KGM2} kg m2, 30 s of steps (22.5 s of them fitted)")
    print(f"{'':16}{'median error':>14}{'95th percentile':>18}{'90 % interval holds':>22}")
    for k, name in enumerate(NAMES):
        latency = name == "latency_s"
        size = error[:, k] * 1e3 if latency else 100 * error[:, k] / truth[:, k]
        unit = "ms" if latency else "%"
        print(
            f"{name:16}{np.median(size):11.3f} {unit:2}{np.quantile(size, 0.95):15.3f} {unit:2}"
            f"{100 * covered[:, k].mean():19.1f} %"
        )
    print(f"latency within 1.5 ms: {100 * np.mean(error[:, 2] < 1.5e-3):.1f} %")


if __name__ == "__main__":
    main()
