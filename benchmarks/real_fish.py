"""A real fish's tail moves a simulated fish: does it swim as fast as the real one did?

    python benchmarks/real_fish.py FOLDER [--device cuda:0] [--cells 0.02 0.01] [--out reports]

FOLDER holds four clips of a tendon-driven robot fish filmed from above. Its joints are prescribed
by the clips (three harmonics of the beat), its body is free. Forward speed is predicted first with
nothing fitted, then with two numbers (an added form drag, a scale of the angles) fitted on two
clips and scored on the other two, all six ways. Writes ``real_fish.json``, ``.md`` and ``.png``.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from tqdm import tqdm

import sim2real as s2r
from sim.robot.shape import draught, hull_of
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array
from sim2real.body import listed
from sim2real.model import JointModel, Model

CLIPS = ("f0_75", "f1_25", "f1_75", "f2_25")
FRAMES = (60.0, 80.0)
"""Frames a second: as published, and as the motor's label would have it."""
FORM_DRAG = (-0.4, -0.2, 0.0, 0.2, 0.4)
ANGLES = (0.9, 1.0, 1.1, 1.2)
"""Scales of the joint angles; the clips' angles are good to 5 to 10 %."""
RIVAL_M_S = 0.019
"""Mean error over eight clips of Michelis et al. (2026): five parameters, fitted on two of them."""
VISCOSITY_M2_S = 5e-5
_SECONDS, _HARMONICS, _START_M_S = 16.0, 3, 0.1


@dataclass(frozen=True)
class Clip:
    """One clip, its motion periodic.

    Attributes:
        name: Of the file.
        beat: Beats in a frame.
        series: Mean, cosines and sines of each joint, shape (J, 1 + 2 harmonics).
        speed: Forward speed in m a frame.
        yaw: Amplitude of the head's yaw at the beat in rad.
    """

    name: str
    beat: float
    series: Array
    speed: float
    yaw: float

    def angles(self, t: Array | float, frames: float) -> Array:
        """Joint angles in rad at t seconds, shape (..., J); no mean bend."""
        terms = _terms(2 * np.pi * self.beat * frames * np.asarray(t))
        return np.asarray(terms[..., 1:] @ self.series[:, 1:].T)


def _terms(phase: Array) -> Array:
    k = np.arange(1, _HARMONICS + 1) * phase[..., None]
    return np.concatenate([np.ones_like(phase)[..., None], np.cos(k), np.sin(k)], axis=-1)


def read_clip(folder: Path, name: str) -> Clip:
    """Read a clip and describe its motion."""
    recording = s2r.read_recording(folder / f"{name}.csv")
    frames = np.rint(recording.t * 60.0)
    beat = float(recording.metadata["measured_frequency_hz"]) / 60.0
    terms = _terms(2 * np.pi * beat * frames)
    series = []
    for angle in recording.position.T:
        seen = np.isfinite(angle)
        series.append(np.linalg.lstsq(terms[seen], angle[seen], rcond=None)[0])
    x, y, yaw = (recording.columns[f"body.{c}"] for c in ("x_m", "y_m", "yaw_rad"))
    turn = np.linalg.lstsq(
        np.column_stack([terms, frames]), np.unwrap(yaw), rcond=None
    )[0]  # fmt: skip
    return Clip(
        name, beat, np.array(series), progress(x, y, yaw, frames), float(np.hypot(turn[1], turn[4]))
    )


def progress(x: Array, y: Array, yaw: Array, t: Array) -> float:
    """Slope of the way along the own heading, per unit of t."""
    middle = (yaw[1:] + yaw[:-1]) / 2
    way = np.cumsum(np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle))
    return float(np.polyfit(t[1:], way, 1)[0])


def floating(robot: s2r.Robot) -> s2r.Robot:
    """The robot with a head as wide as makes it float with its highest part at the surface.

    The volumes in the file are those of the blocks that were measured, and do not add up to the
    fish's mass: Archimedes' principle says what the hull displaces besides them.
    """
    mass = sum(link.mass_kg for link in robot.links)
    tops = [one.at_m[2] + one.size_m[2] / 2 for one in robot.appendages]
    top = max(robot.links[0].height_m / 2, *tops, 0.0)

    def above(width: float) -> float:
        wide = replace(robot.links[0], width_m=width)
        hull = hull_of(replace(robot, links=(wide, *robot.links[1:])))
        found = draught(hull, mass, robot.appendages)
        return (0.2 if found is None else found) - top

    width = brentq(above, 0.03, 0.15, xtol=1e-4)
    return replace(robot, links=(replace(robot.links[0], width_m=width), *robot.links[1:]))


def swim(
    robot: s2r.Robot,
    clips: list[Clip],
    cell: float,
    device: str,
    drags: Sequence[float] = FORM_DRAG,
    scales: Sequence[float] = ANGLES,
) -> tuple[Array, Array, Array]:
    """Speed (m/s), drift of it and head yaw, each (clips, frames, drags, scales)."""
    grid = list(itertools.product(clips, FRAMES, drags, scales))
    servo = JointModel(1.0, 0.1, 0.0, 0.001)
    joints = {joint.name: servo for joint in robot.joints}
    models = [
        Model(joints=joints, body={"effects": listed({"form_drag.coefficient": drag})})
        for _, _, drag, _ in grid
    ]
    swimmer = Swimmer(
        robot, models, n_envs=len(grid), cell_m=cell, viscosity_m2_s=VISCOSITY_M2_S,
        device=device, threads=2, substeps=2 * int(np.ceil(0.02 * 1.6 / 0.15 / cell / 2)),
    )  # fmt: skip

    def angles(t: float) -> Array:
        grown = min(1.0, t)
        return np.array([grown * a * clip.angles(t, f) for clip, f, _, a in grid])

    q = swimmer.bodies.motion.q.numpy().copy()
    v = np.zeros_like(q)
    v[:, 0] = _START_M_S
    swimmer.bodies.place(q, v)
    com = swimmer.bodies.chain.com.numpy()[0, 0] + swimmer.hull.half_width[0, 0]
    track = []
    for k in tqdm(range(round(_SECONDS / CONTROL_S)), desc=f"{cell:g} m", disable=None):
        t = (k + 1) * CONTROL_S
        swimmer.follow(angles(t), (angles(t + 1e-4) - angles(t - 1e-4)) / 2e-4)
        track.append(swimmer.state().pose)
    pose = np.array(track)
    t = CONTROL_S * np.arange(1, len(pose) + 1)
    x = pose[..., 0] + com * np.cos(pose[..., 2])  # the very front, as on the clips
    y = pose[..., 1] + com * np.sin(pose[..., 2])
    speed, drift, yaw = np.zeros((3, len(grid)))
    stopped = swimmer.state().stopped
    for e, (clip, frames, _, _) in enumerate(grid):
        period = 1 / (clip.beat * frames)
        last = round(max(1, round(4.0 / period)) * period / CONTROL_S)
        now, before = slice(-last, None), slice(-2 * last, -last)
        one, other = (
            progress(x[s, e], y[s, e], pose[s, e, 2], t[s]) for s in (now, before)
        )  # fmt: skip
        speed[e], drift[e] = one, one - other
        terms = np.column_stack([_terms(2 * np.pi / period * t[now]), t[now]])
        wave = np.linalg.lstsq(terms, np.unwrap(pose[now, e, 2]), rcond=None)[0]
        yaw[e] = np.hypot(wave[1], wave[4])
        if stopped[e] >= 0:
            speed[e] = drift[e] = yaw[e] = np.nan
    shape = len(clips), len(FRAMES), len(drags), len(scales)
    return speed.reshape(shape), drift.reshape(shape), yaw.reshape(shape)


def at(table: Array, drag: float, scale: float) -> Array:
    """Between the grid's points; table is (clips, drags, scales)."""
    by_drag = np.array([[np.interp(scale, ANGLES, row) for row in clip] for clip in table])
    return np.array([np.interp(drag, FORM_DRAG, row) for row in by_drag])


def fitted(table: Array, measured: Array, chosen: tuple[int, ...]) -> tuple[float, float]:
    """The drag and the scale of the angles that suit the chosen clips best."""
    drags, scales = (np.linspace(v[0], v[-1], 61) for v in (FORM_DRAG, ANGLES))
    off = [
        (np.abs(at(table, d, s)[list(chosen)] - measured[list(chosen)]).sum(), d, s)
        for d in drags
        for s in scales
    ]
    _, drag, scale = min(off)
    return float(drag), float(scale)


def main() -> None:
    """Swim all clips, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.02])
    parser.add_argument("--fine", type=float, nargs="*", default=[], help="nothing fitted there")
    parser.add_argument("--out", type=Path, default=Path("reports"))
    options = parser.parse_args()
    clips = [read_clip(options.folder, name) for name in CLIPS]
    robot = floating(s2r.read_robot(options.folder / "robot.toml"))
    result: dict[str, Any] = {"head_width_m": robot.links[0].width_m, "cells": [], "fine": []}
    for cell in options.cells:
        speed, drift, yaw = swim(robot, clips, cell, options.device)
        result["cells"].append(
            {"cell_m": cell}
            | {k: v.tolist() for k, v in (("speed", speed), ("drift", drift), ("yaw", yaw))}
        )
    for cell in options.fine:
        speed, drift, _ = swim(robot, clips, cell, options.device, (0.0,), (1.0,))
        found = {"speed": speed[..., 0, 0].tolist(), "drift": drift[..., 0, 0].tolist()}
        result["fine"].append({"cell_m": cell} | found)
        print(f"{cell:g} m, nothing fitted: {found}", flush=True)
    for i, frames in enumerate(FRAMES):
        measured = np.array([clip.speed * frames for clip in clips])
        for row in result["cells"]:
            table = np.array(row["speed"])[:, i]
            plain = at(table, 0.0, 1.0)
            scored = np.full((2, len(clips)), 0.0)
            choices = []
            for chosen in itertools.combinations(range(len(clips)), 2):
                drag, scale = fitted(table, measured, chosen)
                predicted = at(table, drag, scale)
                choices.append({"clips": [CLIPS[k] for k in chosen], "drag": drag, "angles": scale})
                for k in set(range(len(clips))) - set(chosen):
                    scored[0, k] += (predicted[k] - measured[k]) / 3
                    scored[1, k] += abs(predicted[k] - measured[k]) / 3
            row[f"at_{frames:g}"] = {
                "measured": measured.tolist(),
                "plain": plain.tolist(),
                "yaw_measured": [clip.yaw for clip in clips],
                "yaw_plain": at(np.array(row["yaw"])[:, i], 0.0, 1.0).tolist(),
                "fits": choices,
                "held_out": scored[1].tolist(),
                "held_out_signed": scored[0].tolist(),
            }
            print(
                f"{row['cell_m']:g} m, {frames:g} frames/s: measured {measured.round(3)}, nothing"
                f" fitted {plain.round(3)} (mean error {np.abs(plain - measured).mean():.3f} m/s),"
                f" two fitted, held out {scored[1].round(3)} (mean {scored[1].mean():.3f} m/s;"
                f" a published simulator {RIVAL_M_S})",
                flush=True,
            )
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "real_fish.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
