"""Robots of ``design_swims.py``, what their cases conceal, and where their files are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from drawn import NOMINAL, Case, Drawn, case_of, robot_of

from sim.inference.swims import Swim, swim_of
from sim2real.model import Model
from sim2real.recording import read_recording

KINDS = ("double", "single", "double", "null")
"""Kinds of a robot's cases, in turn."""


@dataclass(frozen=True)
class Options:
    """What all robots share."""

    out: Path
    seed: int
    cases: int
    seconds: float
    cell_m: float
    water: bool
    water_cell_m: float
    again: bool
    search: dict[str, int]


@dataclass(frozen=True)
class Bench:
    """One robot, with what is concealed in its cases."""

    folder: Path
    drawn: Drawn
    cases: list[Case]
    model: Model

    def path(self, k: int | None, name: str) -> Path:
        """File of a case, or of the robot."""
        return self.folder / name if k is None else self.folder / f"case_{k:02d}" / name

    def read(self, path: Path) -> Swim:
        """A swim that was recorded."""
        return swim_of(read_recording(path), self.drawn.robot)

    def complete(self, *names: str) -> list[int]:
        """Cases of which all files of these names exist; a stopped swim has none."""
        files = {k: [self.path(k, name) for name in names] for k in range(len(self.cases))}
        return [k for k, paths in files.items() if all(path.exists() for path in paths)]


def bench_of(options: Options, number: int) -> Bench:
    """Draw a robot and its cases."""
    rng = np.random.default_rng([options.seed, number])
    drawn = robot_of(rng, f"robot {number}")
    materials = {f"surface_friction.{link.material}" for link in drawn.robot.links}
    names = [n for n in NOMINAL if not n.startswith("surface") or n in materials]
    cases = [
        case_of(KINDS[k % len(KINDS)], names[int(rng.integers(len(names)))], rng, drawn.robot)
        for k in range(options.cases)
    ]
    return Bench(options.out / f"robot_{number:02d}", drawn, cases, drawn.model())
