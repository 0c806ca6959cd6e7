"""How swimming speed and forces depend on the size of the cells, in three dimensions.

    python benchmarks/resolution.py [--device cuda:0] [--cells 0.02 0.01 0.005] [--wall forcing]

The three-joint robot swims with its servos under four travelling waves; its speed is that of the
last seconds. Then its body is held: towed straight, beating without advance, beating while towed.
What other runs have found for other cells or waves stays in ``resolution.json``, so that cells can
be simulated on several machines; ``resolution.png`` shows all. ``--wall forcing`` writes
``forcing.json`` and ``forcing.png``.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fluid_speed import MODEL, ROBOT, WALLS
from harness import command_line
from tqdm import tqdm

from sim.fluid.wall import Wall
from sim.robot.multibody import HELD
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array

VISCOSITY_M2_S = 5e-5
"""The same at all sizes, so that only the cells differ."""
SECONDS, COUNTED = 8.0, 4.0
HELD_S, HELD_COUNTED = 3.0, 2.0
ADVANCE = (0.2, 0.0, 0.18)
CASES = ("towed at 0.2 m/s", "beat", "beat, towed at 0.18 m/s")
_SIZE, _LAG = np.array([0.30, 0.45, 0.60]), 1.2 * np.arange(3)


@dataclass(frozen=True)
class Wave:
    """A travelling wave of set-points.

    Attributes:
        hertz: Its frequency; a whole number of beats is counted.
        scale: Of the amplitudes 0.30, 0.45, 0.60 rad.
    """

    hertz: float
    scale: float

    def command(self, t: float) -> Array:
        """Set-points in rad, growing over the first second, shape (3,)."""
        bend = _SIZE * np.sin(2 * np.pi * self.hertz * t - _LAG)
        return np.asarray(min(1.0, t) * self.scale * bend)

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.hertz:g} Hz x {self.scale:g}"


WAVES = (Wave(1.0, 1.0), Wave(1.5, 0.8), Wave(0.75, 1.2), Wave(1.0, 0.7))


def main() -> None:
    """Swim and hold at each size, print, write."""
    parser = command_line(
        __doc__, device="cpu", cells=[0.04, 0.02], waves=([0, 1, 2, 3], "which swim"),
        seconds=(SECONDS, "of a free swim"), no_held=(False, "do not measure held forces"),
        out=Path("reports/resolution"),
    )  # fmt: skip
    parser.add_argument("--wall", choices=WALLS, default="ghost")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    wall = WALLS[options.wall]
    target = options.out / ("resolution.json" if wall.ghosts else "forcing.json")
    rows: dict[float, dict[str, Any]] = {}
    if target.exists():
        rows = {row["cell_m"]: row for row in json.loads(target.read_text())["rows"]}
    for cell in sorted(options.cells, reverse=True):
        row = rows.setdefault(cell, {"cell_m": cell, "speed_m_s": [[None, None] for _ in WAVES]})
        start = time.perf_counter()
        speed = []
        if options.waves:
            speed = swim(cell, options.device, options.waves, wall, options.seconds)
        for k, found in zip(options.waves, speed, strict=True):
            row["speed_m_s"][k] = [float(x) for x in found]
        if not options.no_held:
            row["force_N"] = [float(x) for x in held(cell, options.device, wall)]
        row["wall_s"] = time.perf_counter() - start
        shown = "  ".join(
            f"{WAVES[k].name} {v:.4f}" for k, (v, _) in zip(options.waves, speed, strict=True)
        )
        print(
            f"{cell:g} m: {shown} m/s, held {row.get('force_N')} N ({row['wall_s']:.0f} s)",
            flush=True,
        )
        result = {
            "waves": [wave.name for wave in WAVES], "cases": list(CASES),
            "viscosity_m2_s": VISCOSITY_M2_S,
            "rows": [rows[c] for c in sorted(rows, reverse=True)],
        }  # fmt: skip
        target.write_text(json.dumps(result, indent=1) + "\n")
    draw(json.loads(target.read_text()), target.with_suffix(".png"))


def swim(cell: float, device: str, which: list[int], wall: Wall, swim_s: float = SECONDS) -> Array:
    """Speed of each wave, and how much its halves differ, shape (waves, 2); NaN where it broke."""
    waves = [WAVES[k] for k in which]
    swimmer = Swimmer(
        ROBOT, MODEL, n_envs=len(waves), cell_m=cell, viscosity_m2_s=VISCOSITY_M2_S,
        device=device, threads=2, wall=wall,
    )  # fmt: skip
    path = []
    for k in tqdm(range(round(swim_s / CONTROL_S)), desc=f"{cell:g} m", disable=None):
        swimmer.step(np.array([wave.command(k * CONTROL_S) for wave in waves]))
        path.append(swimmer.state().pose[:, :2])
    places, stopped = np.array(path), swimmer.state().stopped
    out = np.full((len(waves), 2), np.nan)
    for k, wave in enumerate(waves):
        back = round(round(COUNTED * wave.hertz) / wave.hertz / CONTROL_S)
        if stopped[k] < 0:
            end, begin = places[-1, k], places[-1 - back, k]
            middle = places[-1 - back // 2, k]
            halves = [np.linalg.norm(part) for part in (end - middle, middle - begin)]
            seconds = back * CONTROL_S
            out[k] = np.linalg.norm(end - begin) / seconds, 2 * (halves[0] - halves[1]) / seconds
    return out


def beat(t: float) -> Array:
    """Angles of the held body's beat at 1 Hz in rad, growing over the first half second, (3,)."""
    return np.asarray(min(1.0, 2 * t) * _SIZE * np.sin(2 * np.pi * t - _LAG))


def held(cell: float, device: str, wall: Wall) -> Array:
    """Mean force along the held body in each of ``CASES`` in N; NaN where the box stopped."""
    swimmer = Swimmer(
        ROBOT, MODEL, n_envs=len(CASES), cell_m=cell, viscosity_m2_s=VISCOSITY_M2_S,
        device=device, threads=2, wall=wall,
    )  # fmt: skip
    bodies, h = swimmer.bodies, swimmer.units.step_s
    beats = np.array([0.0, 1.0, 1.0])[:, None]

    every, force = max(1, swimmer.substeps // 16), []
    for k in tqdm(range(round(HELD_S / CONTROL_S)), desc=f"{cell:g} m, held", disable=None):
        seen = []
        for j in range(swimmer.substeps):
            t = k * CONTROL_S + j * h
            v = np.zeros((len(CASES), 3 + len(_SIZE)))
            v[:, 0] = np.array(ADVANCE) * min(1.0, t / 0.3)
            v[:, 3:] = beats * (beat(t + h) - beat(t)) / h
            bodies.prescribe(v)
            bodies.step(HELD)
            if j % every == 0:
                seen.append(bodies.motion.force.numpy()[:, :, 0].sum(axis=1))
        swimmer._sponge()
        force.append(np.mean(seen, axis=0))
    mean = np.mean(force[-round(HELD_COUNTED / CONTROL_S) :], axis=0)
    return np.where(swimmer.state().stopped < 0, mean, np.nan)


def draw(result: dict[str, Any], target: Path) -> None:
    """Speed and force against the cell, over those in the finest cells."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = sorted(result["rows"], key=lambda row: -row["cell_m"])
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained", sharex=True)
    for k, wave in enumerate(result["waves"]):
        swum = [(row["cell_m"], row["speed_m_s"][k][0]) for row in rows if row["speed_m_s"][k][0]]
        axes[0].plot([100 * c for c, _ in swum], [v for _, v in swum], "o-", label=wave)
    for k, case in enumerate(result["cases"]):
        pushed = [(row["cell_m"], row["force_N"][k]) for row in rows if "force_N" in row]
        axes[1].plot([100 * c for c, _ in pushed], [f for _, f in pushed], "o-", label=case)
    axes[0].set(ylabel="speed (m/s)", ylim=(0, None), title="swimming freely")
    axes[1].set(ylabel="mean force along the body (N)", title="body held, motion prescribed")
    for axis in axes:
        axis.set(xlabel="side of a cell (cm)", xscale="log")
        axis.set_xticks([2, 1, 0.5, 0.25], ["2", "1", "0.5", "0.25"])
        axis.minorticks_off()
        axis.invert_xaxis() if axis is axes[0] else None
        axis.legend(frameon=False, fontsize=8)
    figure.savefig(target, dpi=120)


if __name__ == "__main__":
    main()
