"""The filmed fish in the fluid, nothing fitted, scored in surge, sway and yaw rate like the twin.

    python benchmarks/real_fish_fluid.py FOLDER [--device cuda:0] [--cells 0.01] [--out reports]

Asks whether the sway that the reduced-order twin lacks is the twin's fault or the film's: the fluid
shares nothing with the twin's law. Writes ``real_fish_fluid.json``, which ``real_fish_page.py``
shows where it is there.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filmed import Film, errors, film
from real_fish import CLIPS, FRAMES, VISCOSITY_M2_S, floating
from real_fish_diagnosis import beats, plain
from scipy.interpolate import CubicSpline
from tqdm import tqdm

import sim2real as s2r
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.output import write_json
from sim2real.velocity import body_velocity

_START_M_S = 0.1


def swum(robot: s2r.Robot, films: Sequence[Film], cell_m: float, device: str) -> list[Array]:
    """Surge, sway, yaw rate of each film's swim, (T, 3); NaN where the fluid broke down."""
    servo = JointModel(1.0, 0.1, 0.0, 0.001)
    model = Model(joints={joint.name: servo for joint in robot.joints}, body={})
    swimmer = Swimmer(
        robot, model, n_envs=len(films), cell_m=cell_m, viscosity_m2_s=VISCOSITY_M2_S,
        device=device, threads=2, substeps=2 * int(np.ceil(0.02 * 1.6 / 0.15 / cell_m / 2)),
    )  # fmt: skip
    q = swimmer.bodies.motion.q.numpy().copy()
    v = np.zeros_like(q)
    v[:, 0] = _START_M_S
    swimmer.bodies.place(q, v)
    longest = max(len(one.swim.command) for one in films)
    motion = [
        CubicSpline(CONTROL_S * np.arange(len(f.swim.command)), f.swim.command) for f in films
    ]
    poses = []
    for k in tqdm(range(longest), desc=f"{cell_m:g} m", disable=None):
        t = CONTROL_S * (k + 1)
        size, grows = (t, 1.0) if t < 1 else (1.0, 0.0)  # the bend grows in the first second
        angle = np.array([path(t) for path in motion])
        rate = np.array([path(t, 1) for path in motion])
        swimmer.follow(size * angle, size * rate + grows * angle)
        poses.append(swimmer.state().pose)
    track = np.array(poses)
    track[:, swimmer.state().stopped >= 0] = np.nan
    out = []
    for e, one in enumerate(films):
        last = (
            len(one.swim.command) - 1
        )  # row k - 1 is the pose when row k of the angles is reached
        pose = track[last - one.swim.t.size : last, e]
        broken = not np.isfinite(pose).all()
        out.append(np.full_like(pose, np.nan) if broken else body_velocity(one.swim.t, pose))
    return out


def main() -> None:
    """Swim, score, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.01])
    parser.add_argument("--out", type=Path, default=Path("reports"))
    options = parser.parse_args()
    if not (options.folder / f"{CLIPS[0]}.csv").is_file():
        raise SystemExit(f"no clips in {options.folder}: nothing done")
    robot = floating(s2r.read_robot(options.folder / "robot.toml"))
    films = [film(options.folder, name, robot, FRAMES[0]) for name in CLIPS]
    rows: list[dict[str, Any]] = []
    for cell_m in options.cells:
        speeds = swum(robot, films, cell_m, options.device)
        by_clip = np.array([errors(said, one) for said, one in zip(speeds, films, strict=True)])
        at_beat = {
            one.swim.name: beats(one, {"fluid": said})["fluid"]
            for said, one in zip(speeds, films, strict=True)
        }
        rows.append({"cell_m": cell_m, "by_clip": by_clip, "mean": by_clip.mean(axis=0)})
        rows[-1] |= {"at_the_beat": at_beat, "speed": [said[:, 0].mean() for said in speeds]}
        print(f"{cell_m:g} m: mean errors of surge, sway, yaw rate, mean speed", end=" ")
        print(by_clip.mean(axis=0).round(4), flush=True)
        for name, said in at_beat.items():
            print(f"  {name}: sway {said['amplitude'][0]:.3f} m/s, {said['phase_deg'][0]:.0f} deg")
    write_json(options.out / "real_fish_fluid.json", plain({"cells": rows}))


if __name__ == "__main__":
    main()
