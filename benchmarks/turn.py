"""The paper's turn by 180 degrees under a hand-made command, as a video and a picture.

    python benchmarks/turn.py [--cell-m 0.01] [--out reports/turn]

The tail beats 1.8 times a second about a bend to one side, faster one way than the other; once the
robot has turned, the bend goes and a wave drives it off. Writes ``turn.mp4``, ``turn.png``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray
from tqdm import tqdm

import sim2real as s2r
from sim.legend import colours
from sim.plane import Plane, depth, plane_of
from sim.render import picture
from sim.swimmer import CONTROL_S, Swimmer
from sim.video import FRAMES_PER_S, Video

Array = NDArray[np.float64]

TURNED_S, SECONDS = 3.3, 6.0
SHOWN_S = (0.0, 0.5, 1.0, 2.0, 3.3, 6.0)
_FULL = 10.0


def command(t: float) -> Array:
    """Set-points of the three joints in rad, found by a random search over such strokes."""
    joint = np.arange(3)
    if t >= TURNED_S:
        wave = np.array([0.30, 0.45, 0.60]) * np.sin(2 * np.pi * 1.5 * t - 1.2 * joint)
        return np.asarray(min(1.0, (t - TURNED_S) / 0.3) * wave)
    phase = 2 * np.pi * 1.8 * t + 0.34 - 0.36 * joint
    stroke = 0.36 * (1 + 0.15 * joint) * np.sin(phase + 0.62 * np.sin(phase))
    return np.clip(0.70 * (1 - 0.06 * joint) + stroke, -0.8, 0.8)


def main() -> None:
    """Swim, film, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cell-m", type=float, default=0.01)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=Path("reports/turn"))
    options = parser.parse_args()
    robot = s2r.read_robot("datasets/servo_steps/robot.toml")
    model = s2r.read_model("reports/servo_steps/model.json")
    swimmer = Swimmer(robot, model, cell_m=options.cell_m, device=options.device, threads=2)
    planes, path = [plane_of(swimmer)], [swimmer.state().pose[0]]
    every = round(1 / CONTROL_S / FRAMES_PER_S)
    with Video(options.out / "turn.mp4") as video:
        for k in tqdm(range(round(SECONDS / CONTROL_S)), desc="turn", disable=None):
            swimmer.step(command(k * CONTROL_S))
            path.append(swimmer.state().pose[0])
            if (k + 1) % every == 0:
                video.add(picture(swimmer, width=960))
            if any(abs((k + 1) * CONTROL_S - t) < CONTROL_S / 2 for t in SHOWN_S):
                planes.append(plane_of(swimmer))
    draw(swimmer, planes, np.array(path), options.out / "turn.png")
    heading = np.degrees(np.array(path)[:, 2])
    reached = np.flatnonzero(np.abs(heading) >= 175)
    when = f"{reached[0] * CONTROL_S:.2f} s" if reached.size else "never"
    print("heading each half second:", heading[::25].round().astype(int).tolist())
    print(f"175 degrees after {when}; heading at the end {heading[-1]:.0f} degrees")


def draw(swimmer: Swimmer, planes: list[Plane], path: Array, target: Path) -> None:
    """The wake at the end, the robot's outline at some moments, its head's track."""
    last = planes[-1]
    figure, axes = plt.subplots(figsize=(9.6, 6.4), layout="constrained")
    nx, ny = last.vorticity.shape
    x0, y0 = (c - last.cell / 2 for c in last.corner)
    image = axes.imshow(
        last.vorticity.T, origin="lower", vmin=-_FULL, vmax=_FULL, interpolation="bicubic",
        cmap=ListedColormap(colours(np.linspace(-1, 1, 255)) / 255),
        extent=(x0, x0 + nx * last.cell, y0, y0 + ny * last.cell),
    )  # fmt: skip
    X, Y = np.meshgrid(
        np.linspace(x0, x0 + nx * last.cell, 900), np.linspace(y0, y0 + ny * last.cell, 600)
    )
    for k, plane in enumerate(planes):
        outline = depth(swimmer.hull, plane.links, X, Y)
        share = k / (len(planes) - 1)
        ink = str(round(0.62 * (1 - share), 2))
        if k == len(planes) - 1:
            axes.contourf(X, Y, outline, levels=[-1, 0], colors=["#faf7f0"], alpha=0.9)
        axes.contour(X, Y, outline, levels=[0.0], colors=[ink], linewidths=1.0 + 0.8 * share)
        nose = plane.links[0]
        ahead = 0.06 * np.array([np.cos(nose[2]), np.sin(nose[2])])
        axes.annotate(
            f"{plane.time:g} s", nose[:2] + ahead, color=ink, ha="center", va="center", fontsize=9
        )
    axes.plot(path[:, 0], path[:, 1], ":", color="#3a3f45", linewidth=1.2)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.set_xlim(x0 + 0.1, x0 + nx * last.cell - 0.1)
    axes.set_ylim(y0 + 0.05, y0 + ny * last.cell - 0.05)
    axes.set_title(f"A turn by 180° in the fluid, cells of {100 * last.cell:g} cm", loc="left")
    figure.colorbar(image, ax=axes, label="vorticity at the end (1/s)", shrink=0.8)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=130)


if __name__ == "__main__":
    main()
