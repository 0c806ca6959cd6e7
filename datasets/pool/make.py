"""Swims that ship: thirty seconds each of a robot in a pool of its own, something concealed.

    python datasets/pool/make.py OUT [--device cuda:0] [--cell-m 0.005] [--processes 2]
    python datasets/pool/make.py OUT --only sine square --seconds 10

A surrogate of reality, and simulated, not measured: see ``world``. Truth goes into ``truth.json``,
which no fit may read.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from camera import NOISE, reported, seen
from drawn import BOX_M
from numpy.typing import NDArray
from tqdm import tqdm
from truth import AREAS, Truth
from world import VISCOSITY_M2_S, Water, World

from sim.robot.swimmer import CONTROL_S
from sim2real.recording import Recording, write_recording

Array = NDArray[np.float64]

_EFFECTS = (
    Truth("clean", kp=(2.3, 1.85, 2.05), kd=(0.068, 0.077, 0.06), latency=(0.066, 0.062, 0.074)),
    Truth("p1", {"skin_viscoelasticity": {"stiffness_Nm_per_rad": 0.9, "relaxation_s": 0.4}}),
    Truth("p2", {"surface_friction.rubber": {"coefficient": 0.06}}),
    Truth("p3", {"pool_current": {"u_m_s": 0.03, "v_m_s": -0.02}}),
    Truth("p4", {"camera_latency": {"latency_s": 0.12}}),
    Truth(
        "p5",
        {
            "trim_asymmetry": {"offset_rad": 0.09},
            "skin_elasticity": {"stiffness_Nm_per_rad": 0.7},
        },
    ),
    Truth(
        "p6",
        {
            "tether": {"stiffness_N_per_m": 0.25, "x_m": 0.3, "y_m": 0.8},
            "camera_rotation": {"angle_rad": 0.12},
        },
    ),
)
WORLDS = tuple(replace(one, areas=AREAS) for one in _EFFECTS)
CALIBRATION = tuple(replace(WORLDS[1], name=name) for name in ("sine", "square"))
"""The robot of ``p1`` under the two signals of the paper's calibration figure."""


_ALL = (*WORLDS, *CALIBRATION)


def command(t: float, joints: int, phase: float, name: str) -> Array:
    """Set-points: a wave, the paper's square in all joints, a wave that turns; rad.

    Those of ``CALIBRATION`` are the paper's: 0.52 rad in all joints, a sine of 1 Hz or a square.
    """
    lag = 1.2 * np.arange(joints)
    if name in ("sine", "square"):
        wave = np.sin(2 * np.pi * (1.0 if name == "sine" else 0.5) * (t - 0.5))
        return np.full(joints, 0.52 * (t >= 0.5) * (wave if name == "sine" else np.sign(wave)))
    size = np.array([0.30, 0.45, 0.60])
    if t < 0.5:
        return np.zeros(joints)
    if t < 12:
        return np.asarray(min(1.0, t - 0.5) * size * np.sin(2 * np.pi * t - lag + phase))
    if t < 18:
        return np.full(joints, 0.52 * np.sign(np.sin(2 * np.pi * 0.5 * (t - 12))))
    bias = 0.25 * np.sin(2 * np.pi * (t - 18) / 12 + phase)
    wave = 0.8 * size * np.sin(2 * np.pi * 1.3 * t - lag)
    return np.asarray(np.clip(wave + bias, -0.78, 0.78))


def swim(numbers: list[int], options: argparse.Namespace) -> None:
    """Swim, film and write some of the worlds, each with its own random numbers."""
    worlds = [_ALL[k] for k in numbers]
    rngs = [np.random.default_rng([options.seed, k]) for k in numbers]
    world = World(
        worlds, device=options.device, cell_m=options.cell_m, rng=rngs[0], water=Water(box_m=BOX_M)
    )
    names = tuple(joint.name for joint in world.robot.joints)
    phases = [rng.uniform(-0.5, 0.5) for rng in rngs]
    times = CONTROL_S * np.arange(round(options.seconds / CONTROL_S))
    sent, pose, joint = [], [], []
    for t in tqdm(times, desc="pool", disable=None):
        at, angle = world.where()
        pose.append(at)
        joint.append(angle)
        sent.append(
            np.array(
                [command(t, len(names), x, one.name) for x, one in zip(phases, worlds, strict=True)]
            )
        )
        world.step(sent[-1])
    if world.stopped().any():
        raise SystemExit(f"boxes stopped: {np.flatnonzero(world.stopped()).tolist()}")
    for e, (one, rng) in enumerate(zip(worlds, rngs, strict=True)):
        angles = np.array(joint)[:, e]
        shown = seen(times, np.array(pose)[:, e], angles, one.effects, rng, NOISE)
        recording = Recording(
            name=one.name, kind="pool", joints=names,
            t=times, command=np.array(sent)[:, e], position=reported(angles, rng),
            medium="water",
            source="Simulated, not measured: datasets/pool/make.py. MIT licence.",
            columns={f"body.{n}": shown[:, i] for i, n in enumerate(("x_m", "y_m", "yaw_rad"))},
        )  # fmt: skip
        write_recording(recording, options.out / f"{one.name}.csv")


def main() -> None:
    """Swim, film, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cell-m", type=float, default=0.005)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--processes", type=int, default=1, help="share the swims, on a CPU")
    parser.add_argument("--only", nargs="+", default=[one.name for one in WORLDS])
    options = parser.parse_args()
    chosen = [k for k, one in enumerate(_ALL) if one.name in options.only]
    parts = [chosen[k :: options.processes] for k in range(options.processes)]
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(swim, parts, repeat(options)))
    if options.only != [one.name for one in WORLDS]:
        return
    truth = {
        "seed": options.seed, "cell_m": options.cell_m, "viscosity_m2_s": VISCOSITY_M2_S,
        "noise": NOISE, "worlds": [asdict(one) for one in WORLDS],
    }  # fmt: skip
    (options.out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
