"""Read what decides a diagnosis of swims off a development set: the twin's error, the thresholds.

    python benchmarks/pool_decisions.py learn DEVELOPMENT [--processes 2]
    python benchmarks/pool_decisions.py choose DEVELOPMENT VERDICTS

``learn`` takes the set's swims in which nothing is missing (of a sealed set nobody may): what a
calibrated twin still gets wrong of them, by signal and band, and what effects it imitates, by
expectation and maximisation on a normal model (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39
(1977) 1). ``choose`` takes the searches of ``datasets/pool/sealed_solve.py`` and looks for the
thresholds whose answers are best. Both write ``sim/inference/law_error.json``.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.inference.blocks import Blocks
from sim.inference.coordinates import Coordinates
from sim.inference.followed import by_followed_twin
from sim.inference.law_error import BANDS, FILE, ROWS, SCHEMA, read_law_error
from sim.inference.searched import learned
from sim.inference.swims import Swim, swim_of
from sim.inference.twin_search import Belief, TwinSwims
from sim2real.model import read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import read_robot

Array = NDArray[np.float64]

_ROUNDS, _STEPS = 3, 15
_LEAST = 0.15
"""Of a guess, that an imitation is at least: few swims know nothing of it."""


def linear(folder: Path, swims: list[Path]) -> dict[str, Any]:
    """Every swim of one robot near the fit to its references, and the law's own fit."""
    known = read_law_error()
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    simulate = by_followed_twin(robot, threads=1)
    references = [swim_of(read_recording(p), robot) for p in sorted(folder.glob("ref_*.csv"))]
    coordinates = Coordinates.of(robot, model)

    def near(swim: Swim, belief: Belief) -> dict[str, Any]:
        problem = TwinSwims(coordinates, [swim], simulate, belief, known.shares)
        x = problem.centre()
        rows, slope = problem.slope(x)
        weight = problem.weights[0].ravel()
        blocks: Blocks = problem.blocks[0]
        return {
            "rows": (rows / weight).astype(np.float32),
            "slope": (slope.slope / weight[:, None]).astype(np.float32),
            "noise": blocks.noise, "power": blocks.power, "band": blocks.band,
        }  # fmt: skip

    belief = learned(references, model, robot, simulate, known)
    loose = replace(belief, imitation=belief.imitation)
    found = [near(swim_of(read_recording(p), robot), loose) for p in swims]
    for k, one in enumerate(references):
        other = learned(
            [r for i, r in enumerate(references) if i != k], model, robot, simulate, known
        )
        found.append(near(one, other))
    return {
        "robot": folder.name,
        "law": {coordinates.columns[k].kind: float(v)
                for k, v in zip(coordinates.base, belief.mean, strict=True)
                if coordinates.columns[k].kind.startswith("twin")},
        "kinds": [c.kind for c in coordinates.columns],
        "nominal": [c.nominal for c in coordinates.columns],
        "swims": found,
    }  # fmt: skip


def sizes(
    robots: list[dict[str, Any]], shares: Array, imitated: dict[str, float]
) -> tuple[Array, dict[str, float]]:
    """One round of EM: shares and imitations from what is left of all swims."""
    square: dict[str, list[float]] = {}
    left, power = np.zeros((4, 3)), np.zeros((4, 3))
    for robot in robots:
        relative = np.array([
            abs(n) if k in ("servo.kp_Nm_per_rad", "servo.kd_Nms_per_rad") else 1.0
            for k, n in zip(robot["kinds"], robot["nominal"], strict=True)
        ])  # fmt: skip
        sd = relative * np.array([imitated[k] for k in robot["kinds"]])
        for one in robot["swims"]:
            K = one["noise"].shape[1]
            rows = np.minimum(np.arange(K), 3)
            size = shares[rows][:, one["band"]].T
            weight = 1 / np.sqrt(one["noise"] + size**2 * one["power"] + 1e-12)
            slope = one["slope"] * weight.reshape(-1, 1)
            error = one["rows"] * weight.ravel()
            inverse = np.linalg.inv(slope.T @ slope + np.diag(1 / sd**2))
            mean = -inverse @ (slope.T @ error)
            for kind, m, v, r in zip(robot["kinds"], mean, np.diag(inverse), relative, strict=True):
                square.setdefault(kind, []).append(float(m**2 + v) / r**2)
            rest = (one["rows"] + one["slope"] @ mean).reshape(weight.shape)
            extra = np.einsum("nf,fg,ng->n", one["slope"], inverse, one["slope"]).reshape(
                weight.shape
            )
            for k in range(K):
                for b in range(3):
                    here = one["band"] == b
                    left[rows[k], b] += float(
                        np.sum(rest[here, k] ** 2 + extra[here, k] - one["noise"][here, k])
                    )
                    power[rows[k], b] += float(np.sum(one["power"][here, k]))
    fresh = {kind: float(np.sqrt(np.mean(v))) for kind, v in square.items()}
    return np.sqrt(np.maximum(left / power, 1e-6)), fresh


def learn(development: Path, processes: int) -> None:
    """The twin's error from swims in which nothing is missing."""
    answers = json.loads((development / "answers.json").read_text())
    nulls: dict[str, list[Path]] = {}
    for case in answers["cases"]:
        if case["kind"] == "null":
            place = development / "inputs" / case["robot"] / case["case"] / "a.csv"
            held = development / "heldout" / case["case"] / "b.csv"
            nulls.setdefault(case["robot"], []).extend([place, held])
    folders = sorted((development / "inputs").glob("robot_*"))
    with ProcessPoolExecutor(processes) as pool:
        robots = list(pool.map(linear, folders, [nulls.get(f.name, []) for f in folders]))
    content = json.loads(FILE.read_text())
    guess = read_law_error()
    shares, imitated = guess.shares, dict(guess.imitated)
    for _ in range(_STEPS):
        shares, fresh = sizes(robots, shares, imitated)
        imitated = {
            k: max(fresh.get(k, v), _LEAST * guess.imitated[k]) for k, v in imitated.items()
        }
    laws = [robot["law"] for robot in robots]
    usual = {k: float(np.mean([law[k] for law in laws])) for k in laws[0]}
    unknown = dict(content["unknown"])
    for k in usual:
        spread = float(np.std([law[k] for law in laws], ddof=1))
        unknown[k] = float(np.hypot(1.3 * spread, imitated[k]))
    for k in [k for k in unknown if k.startswith("servo")]:
        unknown[k] = float(np.hypot(unknown[k], imitated[k]))
    content |= {
        "schema": SCHEMA,
        "shares": {r: dict(zip(BANDS, map(float, row), strict=True)) for r, row in zip(ROWS, shares, strict=True)},
        "imitated": imitated, "unknown": unknown, "usual": usual,
        "from": f"{sum(len(r['swims']) for r in robots)} swims of {len(robots)} robots in which "
        "nothing is missing, of the development set (seed 20) of datasets/pool/sealed.py",
    }  # fmt: skip
    write_json(FILE, content)
    print(json.dumps({k: content[k] for k in ("shares", "imitated", "unknown", "usual")}, indent=1))


def main() -> None:
    """Learn or choose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("learn")
    one.add_argument("development", type=Path)
    one.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    learn(options.development, options.processes)


if __name__ == "__main__":
    main()
