"""A real fish's tail moves a simulated fish: does it swim as fast as the real one did?

    python benchmarks/real_fish.py FOLDER [--device cuda:0] [--cells 0.01 0.0067] [--wall forcing]

FOLDER holds four clips of a tendon-driven robot fish filmed from above. Its joints are prescribed
by the clips (three harmonics of the beat), its body is free, and it carries what its hull leaves
out (``fish_blocks``). Forward speed is predicted in the twin, and in the fluid where ``--cells``
are given: first with nothing fitted, then with one number, a factor on the drag areas, fitted on
two clips and scored on the other two, all six ways. Then, without the appendages, how much drag the
file seems to lack (``sim.inference.resistance``). Results are added to ``real_fish.json``, of which
``real_fish_page.py`` makes the page.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from fish_blocks import open_tail, with_blocks
from fluid_speed import WALLS
from scipy.optimize import brentq
from tqdm import tqdm

import sim2real as s2r
from sim.fluid.wall import Wall
from sim.inference.resistance import AREA, PLACE, from_figures, grid_of
from sim.robot.shape import draught, hull_of
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.prescribed import RUN_UP_S, by_film, follower
from sim2real.arrays import Array
from sim2real.body import listed
from sim2real.model import JointModel, Model
from sim2real.output import write_json

CLIPS = ("f0_75", "f1_25", "f1_75", "f2_25")
FRAMES = (60.0, 80.0)
"""Frames a second: as published, and as the motor's label would have it."""
FACTORS = (0.7, 1.0, 1.4, 2.0, 3.0, 4.0)
"""Factors on the drag areas of the appendages."""
RIVAL_M_S = 0.019
"""Mean error over eight clips of Michelis et al. (2026): five parameters, fitted on two of them."""
VISCOSITY_M2_S = 5e-5
LENGTH_M = 0.56
"""Of the body."""
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


@dataclass(frozen=True)
class Swum:
    """Simulated swims: forward speed in m/s, its drift, head's yaw in rad, (clips, frames, V)."""

    speed: Array
    drift: Array
    yaw: Array


Bodies = Sequence[Mapping[str, float]]
"""Effects of the body of each of V variants, by name."""
Swim = Callable[[s2r.Robot, Sequence[Clip], Sequence[float], Bodies], Swum]


def seen(pose: Array, period: float, front_m: float) -> tuple[float, float]:
    """Forward speed and amplitude of the yaw in the last whole beats of four seconds."""
    rows = round(max(1, round(4.0 / period)) * period / CONTROL_S)
    x, y, yaw = pose[-rows:].T
    t = CONTROL_S * np.arange(rows)
    x, y = x + front_m * np.cos(yaw), y + front_m * np.sin(yaw)  # the very front, as on the clips
    terms = np.column_stack([_terms(2 * np.pi / period * t), t])
    wave = np.linalg.lstsq(terms, np.unwrap(yaw), rcond=None)[0]
    return progress(x, y, yaw, t), float(np.hypot(wave[1], wave[4]))


def in_twin(
    robot: s2r.Robot, clips: Sequence[Clip], frames: Sequence[float], bodies: Bodies
) -> Swum:
    """The clips in the reduced-order twin."""
    servos = {joint.name: follower() for joint in robot.joints}
    models = [Model(joints=servos, body={"effects": listed(body)}) for body in bodies]
    simulate, front = by_film(robot), robot.links[0].com_m or 0.0
    t = CONTROL_S * np.arange(-round(RUN_UP_S / CONTROL_S), round(9.0 / CONTROL_S))
    speed, drift, yaw = np.zeros((3, len(clips), len(frames), len(bodies)))
    for i, clip in enumerate(clips):
        for j, rate in enumerate(frames):
            period = 1 / (clip.beat * rate)
            tracks = simulate(models, clip.angles(t, rate), np.zeros(3))[:, :, :3]
            for k, pose in enumerate(tracks):
                speed[i, j, k], yaw[i, j, k] = seen(pose, period, front)
                drift[i, j, k] = speed[i, j, k] - seen(pose[:-200], period, front)[0]
    return Swum(speed, drift, yaw)


def in_fluid(cell_m: float, device: str, wall: Wall) -> Swim:
    """The clips in the fluid, in cells of this size; all at once."""

    def run(
        robot: s2r.Robot, clips: Sequence[Clip], frames: Sequence[float], bodies: Bodies
    ) -> Swum:
        grid = list(itertools.product(clips, frames, bodies))
        joints = {joint.name: JointModel(1.0, 0.1, 0.0, 0.001) for joint in robot.joints}
        swimmer = Swimmer(
            robot,
            [Model(joints=joints, body={"effects": listed(body)}) for _, _, body in grid],
            n_envs=len(grid), cell_m=cell_m, viscosity_m2_s=VISCOSITY_M2_S, device=device,
            threads=2, wall=wall, substeps=2 * int(np.ceil(0.02 * 1.6 / 0.15 / cell_m / 2)),
        )  # fmt: skip

        def angles(t: float) -> Array:
            return np.array([min(1.0, t) * clip.angles(t, rate) for clip, rate, _ in grid])

        q = swimmer.bodies.motion.q.numpy().copy()
        v = np.zeros_like(q)
        v[:, 0] = _START_M_S
        swimmer.bodies.place(q, v)
        track = []
        for k in tqdm(range(round(_SECONDS / CONTROL_S)), desc=f"{cell_m:g} m", disable=None):
            t = (k + 1) * CONTROL_S
            swimmer.follow(angles(t), (angles(t + 1e-4) - angles(t - 1e-4)) / 2e-4)
            track.append(swimmer.state().pose)
        pose, stopped = np.array(track), swimmer.state().stopped
        pose[:, stopped >= 0] = np.nan
        front = robot.links[0].com_m or 0.0
        out = np.full((3, len(grid)), np.nan)
        for e in np.flatnonzero(stopped < 0):
            clip, rate, _ = grid[e]
            period = 1 / (clip.beat * rate)
            speed, yaw = seen(pose[:, e], period, front)
            out[:, e] = speed, speed - seen(pose[:-200, e], period, front)[0], yaw
        speed, drift, yaw = out.reshape(3, len(clips), len(frames), len(bodies))
        return Swum(speed, drift, yaw)

    return run


def by_factor(table: Array, factor: float) -> Array:
    """Between the grid's factors; table is (clips, factors)."""
    return np.array([np.interp(np.log(factor), np.log(FACTORS), row) for row in table])


def one_number(table: Array, measured: Array) -> dict[str, Any]:
    """The factor fitted on each two clips, and the errors of the other two."""
    tried = np.geomspace(FACTORS[0], FACTORS[-1], 201)
    off = np.array([by_factor(table, factor) - measured for factor in tried])
    fits, held = [], np.zeros(len(measured))
    for chosen in itertools.combinations(range(len(measured)), 2):
        best = int(np.argmin(np.abs(off[:, chosen]).sum(axis=1)))
        fits.append({"clips": [CLIPS[k] for k in chosen], "factor": float(tried[best])})
        for k in set(range(len(measured))) - set(chosen):
            held[k] += abs(off[best, k]) / 3
    return {"fits": fits, "held_out": held.tolist(), "mean": float(held.mean())}


def scored(found: Swum, bare: Swum, clips: Sequence[Clip], k: int) -> dict[str, Any]:
    """Measured and predicted at ``FRAMES[k]``; speeds also in body lengths a beat."""
    measured = np.array([clip.speed * FRAMES[k] for clip in clips])
    beat = np.array([clip.beat * FRAMES[k] for clip in clips])
    plain = found.speed[:, k, FACTORS.index(1.0)]
    return {
        "beat_hz": beat.tolist(),
        "measured": measured.tolist(),
        "plain": plain.tolist(),
        "error": float(np.abs(plain - measured).mean()),
        "lengths_a_beat": [(v / beat / LENGTH_M).tolist() for v in (measured, plain)],
        "without": bare.speed[:, k, 0].tolist(),
        "yaw_measured": [clip.yaw for clip in clips],
        "yaw_plain": found.yaw[:, k, FACTORS.index(1.0)].tolist(),
        "yaw_without": bare.yaw[:, k, 0].tolist(),
        "one_number": one_number(found.speed[:, k], measured),
    }


def lacking(robot: s2r.Robot, clips: Sequence[Clip], swim: Swim) -> dict[str, Any]:
    """What the file of the robot without appendages seems to lack, at ``FRAMES[0]``."""
    grid = grid_of(robot, areas=7, places=2)
    found = swim(robot, clips, FRAMES[:1], [{AREA: a, PLACE: x} for a, x in grid])
    size = np.array([clip.beat * FRAMES[0] for clip in clips])[:, None] * 2 * np.pi / np.sqrt(2)
    said = np.stack([found.speed[:, 0], found.yaw[:, 0] * size], axis=-1)
    speed, yaw = (np.array([getattr(clip, name) for clip in clips]) for name in ("speed", "yaw"))
    measured = np.stack([speed * FRAMES[0], yaw * size[:, 0]], axis=1)
    one = from_figures(measured, said.swapaxes(0, 1), grid)
    return {
        "area_m2": vars(one.area), "x_m": vars(one.place), "log_odds": one.log_odds,
        "left_out": one.left_out.tolist(),
    }  # fmt: skip


def run_of(folder: Path, swim: Swim, clips: Sequence[Clip]) -> dict[str, Any]:
    """Everything in one simulator."""
    plain = s2r.read_robot(folder / "robot.toml")
    whole = with_blocks(plain, folder / "blocks.toml")
    factors = [{"appendage_area.ratio": factor - 1} for factor in FACTORS]
    found = swim(floating(whole), clips, FRAMES, factors)
    bare = swim(floating(plain), clips, FRAMES, [{}])
    ajar = swim(floating(open_tail(whole, folder / "blocks.toml")), clips, FRAMES[:1], [{}])
    row: dict[str, Any] = {
        "speed": found.speed.tolist(), "yaw": found.yaw.tolist(), "drift": found.drift.tolist(),
        "open_tail": {"speed": ajar.speed[:, 0, 0].tolist(), "yaw": ajar.yaw[:, 0, 0].tolist()},
        "lacking": lacking(floating(plain), clips, swim),
    }  # fmt: skip
    row |= {f"at_{rate:g}": scored(found, bare, clips, k) for k, rate in enumerate(FRAMES)}
    for rate in FRAMES:
        one = row[f"at_{rate:g}"]
        print(
            f"{rate:g} frames/s: measured {np.round(one['measured'], 3)}, nothing fitted"
            f" {np.round(one['plain'], 3)} (mean error {one['error']:.3f} m/s), one number, held"
            f" out {one['one_number']['mean']:.3f} m/s",
            flush=True,
        )
    return row


def areas_of(robot: s2r.Robot) -> list[dict[str, Any]]:
    """Drag areas and added masses of the appendages, wholly under water."""
    return [
        {"name": one.name, **{k: v for k, v in vars(one.wetted(np.inf)).items() if k != "place_m"}}
        for one in robot.appendages
    ]


def main() -> None:
    """Swim all clips, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="*", default=[], help="of the fluid, in m")
    parser.add_argument("--wall", choices=WALLS, default="ghost", help="of the fluid")
    parser.add_argument("--out", type=Path, default=Path("reports"))
    options = parser.parse_args()
    if not (options.folder / f"{CLIPS[0]}.csv").is_file():
        raise SystemExit(f"no clips in {options.folder}: nothing done")
    clips = [read_clip(options.folder, name) for name in CLIPS]
    robot = s2r.read_robot(options.folder / "robot.toml")
    whole = floating(with_blocks(robot, options.folder / "blocks.toml"))
    file = options.out / "real_fish.json"
    before = json.loads(file.read_text()) if file.is_file() else {}
    runs = {run["where"]: run for run in before.get("runs", [])}
    simulators: dict[str, Swim] = {"twin": in_twin}
    for cell in options.cells:
        name = f"fluid, {100 * cell:.2g} cm" + ", forcing" * (options.wall == "forcing")
        simulators[name] = in_fluid(cell, options.device, WALLS[options.wall])
    for where, swim in simulators.items():
        print(where, flush=True)
        runs[where] = {"where": where} | run_of(options.folder, swim, clips)
        result = {
            "head_width_m": [whole.links[0].width_m, floating(robot).links[0].width_m],
            "factors": FACTORS, "appendages": areas_of(whole), "runs": list(runs.values()),
        }  # fmt: skip
        options.out.mkdir(parents=True, exist_ok=True)
        write_json(file, result)


if __name__ == "__main__":
    main()
