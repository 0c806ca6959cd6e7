"""Recordings made from the paper's own randomization table: does ``ranges`` give it back?

Lin, Liu, Wang (2024), Table II: command latency 68 +- 20 ms uniform, an episode; noise of position
0.05 m, direction 3 degrees and joint angles 2 degrees, normal, a step. Each episode is 30 s at
50 Hz of three servos under the paper's 1 Hz sine or 0.5 Hz square of 0.52 rad, while the body
swims. The servos are integrated here, at a third of a millisecond, with no code of the library.

    python -m benchmarks.paper_table --seeds 10 [--out reports/ranges/paper_table.json]
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.harness import command_line, table
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.output import write_json
from sim2real.ranges.entry import Ranges
from sim2real.ranges.gather import gather
from sim2real.recording import Recording
from sim2real.robot import Joint, Link, Robot, Servo

LATENCY_S, LATENCY_HALF_S = 0.068, 0.020
POSITION_M, DIRECTION_RAD, JOINT_RAD = 0.05, np.deg2rad(3.0), np.deg2rad(2.0)
EPISODES, SECONDS, RATE_HZ = 40, 30.0, 50.0
AMPLITUDE_RAD = 0.52
JOINTS = ("j1", "j2", "j3")
INERTIA = np.array([0.0022, 0.0018, 0.0015])
KP, KD = np.array([1.9, 1.7, 1.5]), np.array([0.07, 0.06, 0.05])
FINE = 60  # steps of integration between samples
DRAWN = "half-width of the latencies that were drawn"


def compared(ranges: Ranges) -> dict[str, float]:
    """Each number of the table as it was found, over what it is."""
    out = {}
    latency = ranges.named("command_latency_s")
    if latency is not None:
        out["latency, centre"] = 0.5 * (latency.first + latency.second) / LATENCY_S
        out["latency, half-width"] = 0.5 * (latency.second - latency.first) / LATENCY_HALF_S
    noises = {"body.position_noise_m": POSITION_M, "body.yaw_noise_rad": DIRECTION_RAD}
    noises |= {f"{joint}.position_noise_rad": float(JOINT_RAD) for joint in JOINTS}
    for name, truth in noises.items():
        entry = ranges.named(name)
        if entry is not None:
            out[name] = entry.second / truth
    return out


def episodes(rng: np.random.Generator, count: int = EPISODES) -> tuple[list[Recording], Array]:
    """Pool recordings and the latency of each, in s, as drawn from the paper's table."""
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    command = np.stack([_commands(t, rng) for _ in range(count)])
    latency = rng.uniform(LATENCY_S - LATENCY_HALF_S, LATENCY_S + LATENCY_HALF_S, count)
    angle = turned(command, latency)
    seen = angle + JOINT_RAD * rng.standard_normal(angle.shape)
    recordings = [
        Recording(
            name=f"swim{k:02}",
            kind="pool",
            joints=JOINTS,
            t=t,
            command=command[k],
            position=seen[k],
            medium="water",
            columns=_swum(t, rng),
        )
        for k in range(count)
    ]
    return recordings, latency


def turned(command: Array, latency: Array) -> Array:
    """Angles (E, T, J) of servos sent ``command`` (E, T, J), each episode late by ``latency`` (E,).

    Semi-implicit Euler steps of a third of a millisecond.
    """
    E, T, J = command.shape
    h = 1 / (RATE_HZ * FINE)
    q, v = command[:, 0].copy(), np.zeros((E, J))
    angle = np.empty_like(command)
    rows = np.arange(E)
    for k in range(T):
        angle[:, k] = q
        for i in range(FINE):
            now = k / RATE_HZ + (i + 0.5) * h
            held = np.clip(np.floor((now - latency) * RATE_HZ + 1e-9), 0, T - 1).astype(int)
            u = command[rows, held]
            v += h * (KP * (u - q) - KD * v) / INERTIA
            q = q + h * v
    return angle


def _commands(t: Array, rng: np.random.Generator) -> Array:
    """A sine or a square wave on every joint, after a second of rest, shape (T, J)."""
    lag = rng.uniform(0, 2 * np.pi) + np.array([0.0, 1.2, 2.4])
    if rng.random() < 0.5:
        wave = np.sin(2 * np.pi * 1.0 * t[:, None] - lag)
    else:
        wave = np.sign(np.sin(2 * np.pi * 0.5 * t[:, None] - lag))
    return np.where(t[:, None] < 1.0, 0.0, AMPLITUDE_RAD * wave)


def _swum(t: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Poses of a body that swims in a wide arc and wags, as the camera sees them."""
    turn, start = rng.uniform(-0.2, 0.2), rng.uniform(-np.pi, np.pi)
    wag = 2 * np.pi * t + rng.uniform(0, 2 * np.pi)
    course = start + turn * t
    x = np.cumsum(0.12 * np.cos(course)) / RATE_HZ - 0.01 * np.sin(course) * np.sin(wag)
    y = np.cumsum(0.12 * np.sin(course)) / RATE_HZ + 0.01 * np.cos(course) * np.sin(wag)
    yaw = course + 0.15 * np.sin(wag + 0.5) + DIRECTION_RAD * rng.standard_normal(t.size)
    return {
        "body.x_m": x + POSITION_M * rng.standard_normal(t.size),
        "body.y_m": y + POSITION_M * rng.standard_normal(t.size),
        "body.yaw_rad": (yaw + np.pi) % (2 * np.pi) - np.pi,
    }


_SERVO = Servo("lx824", 1.67, 5.24, 0.0)
_LINK = Link("link", 0.3, 0.13, 0.1, 0.1)
ROBOT = Robot("fish", (_LINK,) * 4, tuple(Joint(name, _SERVO, (-0.8, 0.8)) for name in JOINTS))
MODEL = Model(
    {name: JointModel(1.2 * KP[k], 0.8 * KD[k], 0.05, INERTIA[k]) for k, name in enumerate(JOINTS)}
)


def main() -> None:
    """Compare the ranges of several sets of recordings with the table that they were made from."""
    options = command_line(__doc__, seeds=10, episodes=EPISODES, out=Path).parse_args()
    found = []
    for seed in tqdm(range(options.seeds), desc="paper table", unit="set", disable=None):
        swum, latency = episodes(np.random.default_rng(seed), options.episodes)
        drawn = {DRAWN: 0.5 * float(np.ptp(latency)) / LATENCY_HALF_S}
        found.append(compared(gather(swum, ROBOT, MODEL).ranges) | drawn)
    ratios = {name: np.array([one[name] for one in found]) for name in found[0]}
    rows = []
    for name, ratio in ratios.items():
        within = f"{int(np.sum(np.abs(ratio - 1) <= 0.1))} of {ratio.size}"
        cells = (f"{x:.3f}" for x in (ratio.mean(), ratio.min(), ratio.max()))
        rows.append((name, *cells, within))
    print(table(("found / true", "mean", "least", "most", "sets within 10 %"), rows))
    if options.out:
        kept = {name: ratio.tolist() for name, ratio in ratios.items()}
        about = {"seeds": options.seeds, "episodes": options.episodes}
        write_json(options.out, about | {"ratio": kept})


if __name__ == "__main__":
    main()
