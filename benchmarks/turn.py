"""The paper's turn by 180 degrees under a hand-made command, as a video and a picture.

    python benchmarks/turn.py [--cell-m 0.01] [--out reports/turn]

The robot bends hard to the left and beats its tail about that bend, faster one way than the other;
once it has turned, a wave about a slight bend drives it off. Writes ``turn.mp4`` and ``turn.png``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from tqdm import tqdm

import sim2real as s2r
from sim.robot.shape import Hull
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.view.legend import colours
from sim.view.plane import Plane, depth, plane_of
from sim.view.render import picture
from sim.view.video import FRAMES_PER_S, Video

Array = NDArray[np.float64]

TURNED_S, SECONDS = 3.3, 6.0
SHOWN_S = (0.0, 0.5, 1.0, 2.0, 3.3, 6.0)
_FULL = 15.0
_VIEW_M = (-0.56, 0.60, -0.44, 0.36)
_TOP = 99
_AHEAD_M = np.array([0.035, 0.06, 0.085])
_HALO = [withStroke(linewidth=3, foreground="white")]


def command(t: float) -> Array:
    """Set-points of the three joints in rad, found by a random search over such strokes."""
    joint = np.arange(3)
    if t >= TURNED_S:
        wave = np.array([0.30, 0.45, 0.60]) * np.sin(2 * np.pi * 1.5 * t - 1.2 * joint)
        return np.asarray(-min(1.0, (t - TURNED_S) / 0.3) * (0.10 + wave))
    phase = 2 * np.pi * 1.8 * t + 0.34 - 0.36 * joint
    stroke = 0.36 * (1 + 0.15 * joint) * np.sin(phase + 0.62 * np.sin(phase))
    return np.asarray(-np.clip(0.70 * (1 - 0.06 * joint) + stroke, -0.8, 0.8))


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
                video.add(picture(swimmer, width=960, vorticity=_FULL))
            if any(abs((k + 1) * CONTROL_S - t) < CONTROL_S / 2 for t in SHOWN_S):
                planes.append(plane_of(swimmer))
    draw(swimmer.hull, planes, np.array(path), options.out / "turn.png")
    heading = np.degrees(np.array(path)[:, 2])
    reached = np.flatnonzero(heading >= 175)
    when = f"{reached[0] * CONTROL_S:.2f} s" if reached.size else "never"
    print("heading each half second:", heading[::25].round().astype(int).tolist())
    print(f"175 degrees after: {when}; heading at the end {heading[-1]:.0f} degrees")


def draw(hull: Hull, planes: list[Plane], path: Array, target: Path) -> None:
    """The wake at the end, the robot's outline at some moments, its head's track and heading."""
    figure = plt.figure(figsize=(11.0, 5.4), layout="constrained")
    above, beside = figure.subplots(1, 2, width_ratios=(2.3, 1))
    _water(above, planes[-1])
    for plane in planes:
        _outline(above, hull, plane)
    above.plot(path[:, 0], path[:, 1], color="white", linewidth=2.4, zorder=_TOP)
    above.plot(path[:, 0], path[:, 1], color="#1c1e21", linewidth=0.9, zorder=_TOP)
    for plane in planes:
        _moment(above, hull, plane, [other for other in planes if other is not plane])
    above.set_title(
        f"A turn by 180° in the fluid, cells of {100 * planes[0].cell:.3g} cm", loc="left"
    )
    scale = ScalarMappable(cmap=ListedColormap(_shades()))
    scale.set_clim(-_FULL, _FULL)
    figure.colorbar(
        scale, ax=above, orientation="horizontal", label="vorticity at the end (1/s)",
        shrink=0.5, aspect=35, pad=0.02,
    )  # fmt: skip
    _heading(beside, path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=130)


def _shades() -> Array:
    """The video's colours, paler, so that outlines stand out."""
    return 1 - 0.75 * (1 - colours(np.linspace(-1, 1, 255)) / 255)


def _water(axes: Axes, seen: Plane) -> None:
    nx, ny = seen.vorticity.shape
    x, y = (c - seen.cell / 2 for c in seen.corner)
    axes.imshow(
        seen.vorticity.T, origin="lower", vmin=-_FULL, vmax=_FULL, interpolation="bicubic",
        cmap=ListedColormap(_shades()), extent=(x, x + nx * seen.cell, y, y + ny * seen.cell),
    )  # fmt: skip
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", autoscale_on=False)
    axes.set(xlim=_VIEW_M[:2], ylim=_VIEW_M[2:])


def _tone(time: float) -> Array:
    """Of a robot at some moment: the later, the darker."""
    early, late, share = np.array([0.93, 0.92, 0.87]), np.array([0.27, 0.33, 0.35]), time / SECONDS
    return np.asarray(early + share**0.7 * (late - early))


def _outline(axes: Axes, hull: Hull, seen: Plane) -> None:
    span = np.linspace(-1.1, 1.1, 700) * hull.body_length
    X, Y = np.meshgrid(seen.links[0, 0] + span, seen.links[0, 1] + span)
    off = depth(hull, seen.links, X, Y)
    over = 2 + seen.time
    axes.contourf(X, Y, off, levels=[-1, 0], colors=[_tone(seen.time)], zorder=over)
    axes.contour(X, Y, off, levels=[0.0], colors=["#1c1e21"], linewidths=1.1, zorder=over)


def _moment(axes: Axes, hull: Hull, seen: Plane, others: list[Plane]) -> None:
    """The time before the nose, or beside it where another outline is in the way."""
    x, y, heading = seen.links[0]
    aside, ahead = np.meshgrid(np.linspace(-1.4, 1.4, 15), hull.half_width[0, 0] + _AHEAD_M)
    X, Y = x + ahead * np.cos(heading + aside), y + ahead * np.sin(heading + aside)
    clear = np.min([depth(hull, other.links, X, Y) for other in others], axis=0)
    best = np.argmax(np.minimum(clear, 0.03) - 0.001 * np.abs(aside) - 0.1 * ahead)
    axes.text(
        X.flat[best], Y.flat[best], f"{seen.time:.3g} s",
        ha="center", va="center", fontsize=9, path_effects=_HALO, zorder=_TOP,
    )  # fmt: skip


def _heading(axes: Axes, path: Array) -> None:
    t, heading = CONTROL_S * np.arange(len(path)), np.degrees(path[:, 2])
    axes.axhline(180, color="#b9bec4", linewidth=0.8)
    axes.axvspan(0, TURNED_S, color="#f1f3f5", linewidth=0)
    axes.plot(t, heading, color="#1c1e21", linewidth=1.4)
    axes.scatter(
        SHOWN_S, np.interp(SHOWN_S, t, heading), 44, [_tone(time) for time in SHOWN_S],
        edgecolors="#1c1e21", zorder=3, clip_on=False,
    )  # fmt: skip
    axes.set(xlabel="time (s)", xlim=(0, SECONDS), ylim=(-10, None), yticks=range(0, 181, 45))
    axes.set_title("heading of the head (degrees)", loc="left", fontsize=10)
    axes.text(0.15, -4, "bent", color="#6a7078", fontsize=9)
    axes.text(TURNED_S + 0.15, -4, "wave", color="#6a7078", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main()
