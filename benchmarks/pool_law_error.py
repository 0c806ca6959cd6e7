"""Estimate the error of the twin from swims of development sets in which nothing is missing.

    python -m benchmarks.pool_law_error SET [SET ...] [--water INPUTS HELD_OUT ...]

The residual of a calibrated twin by signal and band, and the effects that it imitates, by
expectation and maximisation on a normal model (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39
(1977) 1). A fit depends on the assumed error, so fits and estimates alternate (``--turns``). The
apparent effects have two standard deviations: between robots, which reference swims determine, and
between the swims of one robot (a linear mixed model; Laird and Ware, Biometrics 38 (1982) 963).
Writes ``sim/inference/law_error.json``; with ``--water``, two folders of
``datasets/pool/sealed_water.py`` for each set, ``law_error_in_water.json``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import command_line, spread
from sim.inference.coordinates import ERROR, SERVO_EFFECTS, Coordinates
from sim.inference.in_water import robot_in_water
from sim.inference.law_error import (
    FILE,
    IN_WATER,
    NEVER,
    RELATIVE,
    LawError,
    read_law_error,
    together,
)
from sim.inference.signal_error import BANDS, ROWS
from sim.inference.swim_problem import SwimProblem
from sim.inference.swims import SwimSimulator, swim_of
from sim2real.arrays import Array
from sim2real.model import Model, read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot

Files = tuple[Path, ...]
_STEPS = 30
_BEGUN = 0.5
"""Initial standard deviation of columns without an earlier one, in steps."""
_WORTH = 10.0
"""Number of robots that an earlier standard deviation counts for: of nearly collinear columns only
a sum is identifiable."""
_OWN = ("error.surge_1", "error.surge_2", "error.surge_3", "error.yaw_off_1")
"""Columns without a part common to a robot: they change along a swim."""


def placed(folder: Path, files: Files) -> tuple[Robot, Model, SwimSimulator]:
    """A robot, its model and its simulator."""
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    return robot, *robot_in_water(robot, model, files, threads=1)


@dataclass(frozen=True)
class Near:
    """Linearised swims of a robot in which nothing is missing, about one point.

    Attributes:
        swims: Unweighted residuals, derivatives, noise, power and band of each.
        kinds, nominal, steps: Of the columns, F of them.
        point: Difference from the nominal values (of the law without water: the values), (F,).
    """

    swims: list[dict[str, Array]]
    kinds: list[str]
    nominal: list[float]
    steps: Array
    point: Array


def near(problem: SwimProblem, x: Array) -> dict[str, Array]:
    """Unweighted residuals and derivatives of a swim at a point (F,)."""
    fit, weight, blocks = problem.at(x), problem.weights[0].ravel(), problem.blocks[0]
    return {
        "rows": (fit.rows / weight).astype(np.float32),
        "slope": (fit.slope / weight[:, None]).astype(np.float32),
        "noise": blocks.noise, "power": blocks.power, "band": blocks.band,
    }  # fmt: skip


def of_robot(job: tuple[Path, Files, list[str]], known: LawError) -> Near:
    """A robot's swims in which nothing is missing, near the fit of its references."""
    folder, files, nulls = job
    robot, model, simulate = placed(folder, files)
    challenge, c = folder.parents[1], Coordinates.of(robot, model)
    usual = known.prior(c)
    paths = sorted(folder.glob("ref_*.csv"))
    references = [swim_of(read_recording(p), robot) for p in paths]
    x = SwimProblem(c, references, simulate, usual).plain().fit.x
    for case in nulls:
        held = challenge / "heldout" / case / "b.csv"
        paths += [folder / case / "a.csv", *([held] if len(files) != 1 else [])]
    swims = [swim_of(read_recording(path), robot) for path in paths if path.exists()]
    law = np.array([one.kind.startswith("twin.") for one in c.columns])
    zero = np.where(law & (not files), 0.0, c.nominal)
    return Near(
        [near(SwimProblem(c, [swim], simulate, usual), x) for swim in swims],
        [one.kind for one in c.columns], [one.nominal for one in c.columns],
        np.array([one.step for one in c.columns]), x - zero,
    )  # fmt: skip


def swims_near(
    sets: Sequence[Path], waters: Sequence[Path], processes: int, known: LawError
) -> list[Near]:
    """``of_robot`` of every robot of some sets."""
    jobs = []
    for k, one in enumerate(sets):
        answers = json.loads((one / "answers.json").read_text())["cases"]
        for folder in sorted((one / "inputs").glob("robot_*")):
            own = [w / f"{folder.name}.npz" for w in waters[2 * k : 2 * k + 2]]
            files = tuple(path for path in own if path.exists())
            nulls = [c for c in answers if c["robot"] == folder.name and c["kind"] == "null"]
            jobs.append((folder, files, [c["case"] for c in nulls]))
    return list(spread(partial(of_robot, known=known), jobs, processes, unit="robot"))


Numbers = dict[str, float]
Levels = tuple[Array, Numbers, Numbers, Numbers]
"""Shares (4, 3); by kind of column, standard deviations of swims about their robot and of robots
about their mean, and that mean."""


def _about(squares: Array, before: float | None) -> float:
    """Root mean square, with an earlier one as a prior."""
    worth = _WORTH if before else 0.0
    return float(np.sqrt((squares.sum() + worth * (before or 0.0) ** 2) / (squares.size + worth)))


def _weighted(swim: dict[str, Array], shares: Array) -> tuple[Array, Array]:
    """Curvature (F, F) and gradient (F,) of a swim's loss at the point."""
    K = swim["noise"].shape[1]
    size = shares[np.minimum(np.arange(K), 3)][:, swim["band"]].T
    weight = 1 / np.sqrt(swim["noise"] + size**2 * swim["power"] + 1e-12)
    slope = swim["slope"] * weight.reshape(-1, 1)
    return slope.T @ slope, slope.T @ (swim["rows"] * weight.ravel())


def _residuals(swim: dict[str, Array], step: Array, spread: Array) -> list[tuple[int, int, float]]:
    """Signal, band and squared share of the residual of a swim beyond its noise."""
    rest = (swim["rows"] + swim["slope"] @ step) ** 2
    rest = rest + np.einsum("nf,nf->n", swim["slope"] @ spread, swim["slope"])
    rest = rest.reshape(swim["noise"].shape) - swim["noise"]
    out = []
    for k in range(rest.shape[1]):
        for b in range(len(BANDS)):
            here = swim["band"] == b
            share = np.sum(rest[here, k]) / np.sum(swim["power"][here, k])
            out.append((min(k, 3), b, float(share)))
    return out


@dataclass(frozen=True)
class Expected:
    """Conditional expectations for one robot; deviations of gains are relative.

    Attributes:
        place: Values of its columns, shape (F,).
        common: Squared deviations of the robot from the mean of robots, shape (F,).
        own: Squared deviations of its swims from the robot, shape (swims, F).
        residuals: Output of ``_residuals`` for all swims.
    """

    place: Array
    common: Array
    own: Array
    residuals: list[tuple[int, int, float]]


def expected(one: Near, levels: Levels) -> Expected:
    """Conditional expectations of a robot in the linearised normal model."""
    shares, swim_sd, robot_sd, usual = levels
    kinds, least = one.kinds, NEVER * one.steps
    relative = np.array([
        abs(n) if k in RELATIVE else 1.0 for k, n in zip(kinds, one.nominal, strict=True)
    ])  # fmt: skip
    each, wide = (
        np.square(np.maximum(relative * [sd.get(k, 0.0) for k in kinds], least))
        for sd in (swim_sd, robot_sd)
    )
    mean = np.array([usual.get(k, 0.0) for k in kinds]) - one.point
    parts = [_weighted(swim, shares) for swim in one.swims]
    whole, pull, inners = together(parts, each)
    spread = np.linalg.inv(whole + np.diag(1 / wide))
    at = spread @ (mean / wide - pull)
    own, residuals = [], []
    for swim, (normal, gradient), inner in zip(one.swims, parts, inners, strict=True):
        step = -inner @ (gradient + normal @ at)
        sure = inner + inner @ normal @ spread @ normal @ inner
        own.append((step**2 + np.diag(sure)) / relative**2)
        kept = np.eye(len(at)) - inner @ normal
        residuals += _residuals(swim, at + step, inner + kept @ spread @ kept.T)
    common = ((at - mean) ** 2 + np.diag(spread)) / relative**2
    return Expected(at + one.point, common, np.array(own), residuals)


def sizes(robots: Sequence[Near], levels: Levels, before: Numbers) -> Levels:
    """One iteration of EM: shares and both standard deviations.

    Earlier standard deviations of robots, ``before``, count for ``_WORTH`` robots.
    """
    expectations = [expected(one, levels) for one in robots]
    pairs = list(zip(robots, expectations, strict=True))

    def by_kind(kind: str, name: str) -> Array:
        found = [getattr(t, name)[..., [k == kind for k in one.kinds]] for one, t in pairs]
        return np.concatenate([f.ravel() for f in found])

    _, swim_sd, robot_sd, usual = levels
    found: list[list[list[float]]] = [[[] for _ in BANDS] for _ in ROWS]
    for one in expectations:
        for row, band, share in one.residuals:
            found[row][band].append(share)
    shares = np.array([[np.mean(cell) for cell in row] for row in found])
    return (
        np.sqrt(np.maximum(shares, 1e-6)),
        {kind: float(np.sqrt(np.mean(by_kind(kind, "own")))) for kind in swim_sd},
        {kind: _about(by_kind(kind, "common"), before.get(kind)) for kind in robot_sd},
        {kind: float(np.mean(by_kind(kind, "place"))) for kind in usual},
    )  # fmt: skip


def learned_from(robots: Sequence[Near], before: LawError, *, in_water: bool) -> dict[str, Any]:
    """The estimated error of the twin, as the file holds it.

    Args:
        robots: Linearised swims in which nothing is missing.
        before: Initial values of the iterations.
        in_water: Whether the fluid corrects the twin.
    """
    kinds = dict(zip(robots[0].kinds, robots[0].steps, strict=True))
    begun = {k: _BEGUN * step for k, step in kinds.items() if k.startswith(ERROR)}
    begun |= before.imitated
    begins = ("servo.", "twin.", "water.", *SERVO_EFFECTS)
    base = {k: before.unknown[k] for k in kinds if k.startswith(begins)}
    wide = {k: 2 * sd for k, sd in begun.items() if k not in _OWN} | base
    usual = {k: 0.0 for k in kinds if k.startswith(("twin.", "water."))}
    usual |= before.shift if in_water else before.usual
    levels: Levels = (before.shares, begun, wide, usual)
    for _ in range(_STEPS):
        levels = sizes(robots, levels, base)
    shares, imitated, common, usual = levels
    return {
        "shares": {
            row: dict(zip(BANDS, map(float, found), strict=True))
            for row, found in zip(ROWS, shares, strict=True)
        },
        "imitated": imitated,
        "unknown": {k: float(np.hypot(sd, imitated.get(k, 0.0))) for k, sd in common.items()},
        "usual": {} if in_water else usual, "shift": usual if in_water else {},
        "from": {"swims": sum(len(one.swims) for one in robots), "robots": len(robots)},
    }  # fmt: skip


def main() -> None:
    """Estimate and write."""
    parser = command_line(
        __doc__, processes=2, turns=1, out=(Path, "another file than that which ships")
    )
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("--water", type=Path, nargs="*", default=[], help="two folders a set")
    options = parser.parse_args()
    begun = IN_WATER if options.water else FILE
    target = options.out or begun
    content, known = json.loads(begun.read_text()), read_law_error(begun)
    for _ in range(options.turns):
        robots = swims_near(options.sets, options.water, options.processes, known)
        found = learned_from(robots, known, in_water=bool(options.water))
        write_json(target, content | found)
        known = read_law_error(target)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
