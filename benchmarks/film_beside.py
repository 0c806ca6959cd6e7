"""Policies and controllers side by side on one swim, filmed in the fluid.

    python benchmarks/film_beside.py policy.npz pnl --task turn --cell-m 0.01 --device cuda:0 \
        --frames FOLDER
    python benchmarks/film_beside.py --frames FOLDER --out turn.mp4

All swim from one start, with one robot drawn from the pool's ranges. The first form keeps the
pictures, so that the machine that swims need not be the one that can write films.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from tqdm import tqdm

import sim2real as s2r
from rl.commands.evaluate import shown
from rl.experiments.evaluate import run_episodes
from rl.experiments.film import Film
from rl.experiments.named import controller_of
from rl.experiments.trials import UNSEEN
from rl.make import draws_of, make_world, own_stream
from rl.task import TASKS
from sim.view.video import FRAMES_PER_S, Video
from sim2real.arrays import Picture
from sim2real.ranges.entry import read_ranges

POOL = Path("datasets/pool")


class Pictures:
    """What ``Film`` writes to, as a video is; keeps the pictures."""

    def __init__(self, width: int) -> None:
        self.width, self.taken = width, list[Picture]()

    def add(self, image: Picture) -> None:
        """Keep one."""
        self.taken.append(image)


def main() -> None:
    """Swim, or put the pictures together."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policies", nargs="*")
    parser.add_argument(
        "--names", nargs="+", help="to be shown (default: of files and controllers)"
    )
    parser.add_argument("--task", default="turn")
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--fidelity", choices=("twin", "fluid"), default="fluid")
    parser.add_argument("--cell-m", type=float, default=0.01)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--gains", type=Path)
    parser.add_argument("--width", type=int, default=480, help="of each, in pixels")
    parser.add_argument("--every", type=int, default=1, help="keep one picture of so many")
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.policies:
        options.frames.mkdir(parents=True, exist_ok=True)
        keep([filmed(options, k) for k in range(len(options.policies))], options)
    if options.out:
        with Video(options.out, frames_per_s=FRAMES_PER_S) as video:
            for path in sorted(options.frames.glob("*.png")):
                video.add(np.asarray(Image.open(path).convert("RGB")))


def filmed(options: argparse.Namespace, k: int) -> list[Picture]:
    """Pictures of one swim."""
    robot, model = s2r.read_robot(POOL / "robot.toml"), s2r.read_model(POOL / "calibrated.json")
    ranges = read_ranges(POOL / "ranges.json")
    policy = options.policies[k]
    limits = [joint.limits_rad for joint in robot.joints]
    draws = draws_of(model, ranges, robot, seed=options.seed + UNSEEN, n=1)
    name = options.names[k] if options.names else shown(policy)
    pictures: Any = Pictures(options.width)
    with own_stream(options.device):
        world = make_world(
            robot, TASKS[options.task], draws, n_envs=1, seed=options.seed,
            fidelity=options.fidelity, device=options.device, cell_m=options.cell_m,
        )  # fmt: skip
        controller = controller_of(policy, limits, 1, gains=options.gains)
        with Film(pictures, world, name, width=options.width) as film:
            swum = run_episodes(world, controller, name=name, watch=film)
    print(f"{name}: {swum.time_s[0]:.2f} s, {swum.reached[0]} waypoints", flush=True)
    return list(pictures.taken)


def keep(films: list[list[Picture]], options: argparse.Namespace) -> None:
    """Write the pictures beside each other; who has arrived waits in the last one."""
    last = max(map(len, films))
    for t in tqdm(range(0, last, options.every), disable=None):
        row = [film[min(t, len(film) - 1)] for film in films]
        Image.fromarray(np.concatenate(row, axis=1)).save(options.frames / f"{t:05d}.png")


if __name__ == "__main__":
    main()
