"""The paper's turn by 180 degrees under a hand-made command, as a video and a picture.

    python benchmarks/turn.py [--search] [--cell-m 0.01] [--out reports/turn]

The robot bends hard to the left and beats its tail about that bend, faster one way than the other;
once it has turned, a wave about a slight bend drives it off. ``--search`` finds the strokes anew
by random search in these cells and writes ``stroke.json``. Writes ``turn.mp4`` and ``turn.png``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap
from matplotlib.patheffects import withStroke
from tqdm import tqdm

import sim2real as s2r
from sim.robot.shape import Hull
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.view.legend import colours
from sim.view.plane import Plane, depth, plane_of
from sim.view.render import picture
from sim.view.video import FRAMES_PER_S, Video
from sim2real.arrays import Array

SECONDS = 6.0
_FULL = 15.0
_AROUND_M = 0.32
_TOP = 99
_AHEAD_M = np.array([0.035, 0.06, 0.085])
_HALO = [withStroke(linewidth=3, foreground="white")]


GENERATIONS, DRAWS = 4, 64


@dataclass(frozen=True)
class Stroke:
    """A turn and the wave after it.

    Attributes:
        hertz, phase: Of the beats of the turn; the phase in rad.
        bend, swing: Middle and amplitude of the first joint in rad.
        taper, growth: Share by which bend falls and swing grows from joint to joint.
        lag: Of a joint behind the one before it, in rad.
        skew: How much faster one way than the other, in rad of phase.
        turned_s: When the wave begins.
        trim: Bend of the wave in rad.
    """

    hertz: float = 1.8
    phase: float = 0.34
    bend: float = 0.70
    swing: float = 0.36
    taper: float = 0.06
    growth: float = 0.15
    lag: float = 0.36
    skew: float = 0.62
    turned_s: float = 3.3
    trim: float = 0.10

    def command(self, t: float) -> Array:
        """Set-points of the three joints in rad."""
        joint = np.arange(3)
        if t >= self.turned_s:
            wave = np.array([0.30, 0.45, 0.60]) * np.sin(2 * np.pi * 1.5 * t - 1.2 * joint)
            return np.asarray(-min(1.0, (t - self.turned_s) / 0.3) * (self.trim + wave))
        phase = 2 * np.pi * self.hertz * t + self.phase - self.lag * joint
        stroke = self.swing * (1 + self.growth * joint) * np.sin(phase + self.skew * np.sin(phase))
        return np.asarray(-np.clip(self.bend * (1 - self.taper * joint) + stroke, -0.8, 0.8))


def headings(strokes: Sequence[Stroke], seconds: float, cell_m: float, device: str) -> Array:
    """Heading of each robot after every control step in degrees, shape (steps, strokes)."""
    robot = s2r.read_robot("datasets/servo_steps/robot.toml")
    model = s2r.read_model("reports/servo_steps/model.json")
    swimmer = Swimmer(robot, model, n_envs=len(strokes), cell_m=cell_m, device=device, threads=2)
    path = []
    for k in tqdm(range(round(seconds / CONTROL_S)), desc="search", disable=None):
        swimmer.step(np.array([stroke.command(k * CONTROL_S) for stroke in strokes]))
        path.append(swimmer.state().pose[:, 2])
    return np.degrees(np.array(path))


def searched(cell_m: float, device: str, draws: int = DRAWS) -> Stroke:
    """The stroke that turns soonest, then the wave that keeps nearest to the heading opposite."""
    rng, best = np.random.default_rng(0), Stroke(turned_s=SECONDS)
    turning = [field.name for field in fields(Stroke) if field.name not in ("turned_s", "trim")]

    def drawn(about: Stroke, names: Sequence[str], size: float) -> list[Stroke]:
        given = asdict(about)
        noise = size * rng.standard_normal((draws - 1, len(names)))
        around = [
            Stroke(
                **(
                    given
                    | {
                        n: given[n] + x * max(abs(given[n]), 0.1)
                        for n, x in zip(names, row, strict=True)
                    }
                )
            )
            for row in noise
        ]
        return [about, *around]

    for size in 0.3 * 0.6 ** np.arange(GENERATIONS):
        tried = drawn(best, turning, size)
        seen = headings(tried, 3.0, cell_m, device)
        arrives = np.where(seen.max(axis=0) >= 175, (seen >= 175).argmax(axis=0), len(seen))
        best = tried[int(np.nanargmin(arrives * CONTROL_S - 1e-3 * np.nanmax(seen, axis=0)))]
        print(f"turned by 175 degrees after {CONTROL_S * arrives.min():.2f} s", flush=True)
    reached = float(CONTROL_S * arrives.min())
    best = Stroke(**(asdict(best) | {"turned_s": reached - 0.1, "trim": 0.0}))
    for size in (0.15, 0.08):
        tried = [
            Stroke(**(asdict(one) | {"trim": best.trim + 4 * size * rng.uniform(-0.5, 0.5)}))
            for one in drawn(best, ("turned_s",), size)
        ]
        seen = headings(tried, SECONDS, cell_m, device)
        off = np.sqrt(((seen[-round(2.0 / CONTROL_S) :] - 180) ** 2).mean(axis=0))
        best = tried[int(np.nanargmin(off))]
        print(
            f"off the heading by {np.nanmin(off):.0f} degrees in the last two seconds", flush=True
        )
    return best


def main() -> None:
    """Swim, film, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cell-m", type=float, default=0.01)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--search", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("reports/turn"))
    options = parser.parse_args()
    kept = options.out / "stroke.json"
    if options.search:
        options.out.mkdir(parents=True, exist_ok=True)
        stroke = searched(options.cell_m, options.device)
        kept.write_text(json.dumps(asdict(stroke), indent=1) + "\n")
    stroke = Stroke(**json.loads(kept.read_text()))
    shown = (0.0, 0.5, 1.0, 1.5, round(stroke.turned_s, 1), SECONDS)
    robot = s2r.read_robot("datasets/servo_steps/robot.toml")
    model = s2r.read_model("reports/servo_steps/model.json")
    swimmer = Swimmer(robot, model, cell_m=options.cell_m, device=options.device, threads=2)
    planes, path = [plane_of(swimmer)], [swimmer.state().pose[0]]
    every = round(1 / CONTROL_S / FRAMES_PER_S)
    with Video(options.out / "turn.mp4") as video:
        for k in tqdm(range(round(SECONDS / CONTROL_S)), desc="turn", disable=None):
            swimmer.step(stroke.command(k * CONTROL_S)[None])
            path.append(swimmer.state().pose[0])
            if (k + 1) % every == 0:
                video.add(picture(swimmer, width=960, vorticity=_FULL))
            if any(abs((k + 1) * CONTROL_S - t) < CONTROL_S / 2 for t in shown):
                planes.append(plane_of(swimmer))
    draw(swimmer.hull, planes, np.array(path), stroke.turned_s, options.out / "turn.png")
    heading = np.degrees(np.array(path)[:, 2])
    reached = np.flatnonzero(heading >= 175)
    when = f"{reached[0] * CONTROL_S:.2f} s" if reached.size else "never"
    print("heading each half second:", heading[::25].round().astype(int).tolist())
    print(f"175 degrees after: {when}; heading at the end {heading[-1]:.0f} degrees")


def draw(hull: Hull, planes: list[Plane], path: Array, turned_s: float, target: Path) -> None:
    """The wake at the end, the robot's outline at some moments, its head's track and heading."""
    figure = plt.figure(figsize=(11.0, 5.4), layout="constrained")
    above, beside = figure.subplots(1, 2, width_ratios=(2.3, 1))
    _water(above, planes[-1], path)
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
    _heading(beside, path, [plane.time for plane in planes], turned_s)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=130)


def _shades() -> Array:
    """The video's colours, paler, so that outlines stand out."""
    return 1 - 0.75 * (1 - colours(np.linspace(-1, 1, 255)) / 255)


def _water(axes: Axes, seen: Plane, path: Array) -> None:
    nx, ny = seen.vorticity.shape
    x, y = (c - seen.cell / 2 for c in seen.corner)
    axes.imshow(
        seen.vorticity.T, origin="lower", vmin=-_FULL, vmax=_FULL, interpolation="bicubic",
        cmap=ListedColormap(_shades()), extent=(x, x + nx * seen.cell, y, y + ny * seen.cell),
    )  # fmt: skip
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", autoscale_on=False)
    (left, low), (right, high) = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    axes.set(xlim=(left - _AROUND_M, right + _AROUND_M), ylim=(low - _AROUND_M, high + _AROUND_M))


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


def _heading(axes: Axes, path: Array, shown: Sequence[float], turned_s: float) -> None:
    t, heading = CONTROL_S * np.arange(len(path)), np.degrees(path[:, 2])
    axes.axhline(180, color="#b9bec4", linewidth=0.8)
    axes.axvspan(0, turned_s, color="#f1f3f5", linewidth=0)
    axes.plot(t, heading, color="#1c1e21", linewidth=1.4)
    axes.scatter(
        shown, np.interp(shown, t, heading), 44, [_tone(time) for time in shown],
        edgecolors="#1c1e21", zorder=3, clip_on=False,
    )  # fmt: skip
    axes.set(xlabel="time (s)", xlim=(0, SECONDS), ylim=(-10, None), yticks=range(0, 181, 45))
    axes.set_title("heading of the head (degrees)", loc="left", fontsize=10)
    axes.text(0.15, -4, "bent", color="#6a7078", fontsize=9)
    axes.text(turned_s + 0.15, -4, "wave", color="#6a7078", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main()
