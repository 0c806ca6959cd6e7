"""How wrong the twin is, from swims in which nothing is missing (of a sealed set nobody may look).

    python benchmarks/pool_law_error.py SET [SET ...] [--water INPUTS HELD_OUT ...]

What a calibrated twin still gets wrong of them, by signal and band, and what effects it imitates,
by expectation and maximisation on a normal model (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39
(1977) 1). A fit bends to what is thought to be the error, so fitting and learning take turns.
Goes on from what was learned before, which counts for the swims and robots that it is from.
Writes ``sim/inference/law_error.json``; with ``--water``, two folders of
``datasets/pool/sealed_water.py`` for each set, ``law_error_in_water.json``.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from sim.inference.blocks import Blocks
from sim.inference.coordinates import Coordinates, Swum
from sim.inference.in_water import robot_in_water
from sim.inference.law_error import (
    BANDS,
    FILE,
    IN_WATER,
    RELATIVE,
    ROWS,
    LawError,
    read_law_error,
)
from sim.inference.searched import learned
from sim.inference.swims import swim_of
from sim.inference.twin_search import Belief, TwinSwims
from sim2real.model import Model, read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot

Array = NDArray[np.float64]

Files = tuple[Path, ...]
_STEPS = 20
_LEAST, _MOST = 0.3, 3.0
"""Of what was known, between which an imitation stays: columns that all but cancel would run
away."""
_WILD = 0.1
"""Share of the largest that is left out."""
_WIDER = 1.3
"""What is allowed for in how far robots differ, since few were seen."""


def placed(folder: Path, files: Files) -> tuple[Robot, Model, Swum]:
    """A robot, its model and its simulator."""
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    return robot, *robot_in_water(robot, model, files, threads=1)


def law(folder: Path, files: Files, known: LawError, without: str = "") -> Belief:
    """What a robot's references say of its law, one of them left out if asked."""
    robot, model, simulate = placed(folder, files)
    paths = [p for p in sorted(folder.glob("ref_*.csv")) if p.name != without]
    references = [swim_of(read_recording(p), robot) for p in paths]
    return replace(learned(references, model, robot, simulate, known), shares=known.shares)


def linear(folder: Path, path: Path, belief: Belief, files: Files) -> dict[str, Any]:
    """A swim in which nothing is missing, near its fit."""
    robot, model, simulate = placed(folder, files)
    c = Coordinates.of(robot, model)
    swim = swim_of(read_recording(path), robot)
    problem = TwinSwims(c, [swim], simulate, belief)
    fit = problem.plain().fit
    spread = np.zeros(2 * [len(c.columns)])
    own = np.diag(np.square(belief.imitation[c.base]))
    spread[np.ix_(c.base, c.base)] = belief.covariance - own
    weight = problem.weights[0].ravel()
    blocks: Blocks = problem.blocks[0]
    return {
        "rows": (fit.rows / weight).astype(np.float32),
        "slope": (fit.near.slope / weight[:, None]).astype(np.float32),
        "off": fit.x - problem.centre(frozenset()), "spread": spread,
        "noise": blocks.noise, "power": blocks.power, "band": blocks.band,
        "kinds": [one.kind for one in c.columns], "nominal": [one.nominal for one in c.columns],
        "robot": str(folder),
    }  # fmt: skip


def of_robot(folder: Path, files: Files, nulls: list[str], known: LawError) -> Learned:
    """A robot's swims in which nothing is missing, each near its fit, and its law."""
    challenge = folder.parents[1]
    whole = law(folder, files, known)
    swims = [
        linear(folder, path, law(folder, files, known, path.name), files)
        for path in sorted(folder.glob("ref_*.csv"))
    ]
    for case in nulls:
        held = challenge / "heldout" / case / "b.csv"
        for path in (folder / case / "a.csv", *([held] if len(files) != 1 else [])):
            if path.exists():
                swims.append(linear(folder, path, whole, files))
    robot, model, _ = placed(folder, files)
    c = Coordinates.of(robot, model)
    means = zip((c.columns[k] for k in c.base), whole.mean, strict=True)
    return swims, {
        one.kind: float(v) - (one.nominal if files else 0.0)
        for one, v in means
        if not one.kind.startswith("servo")
    }


Learned = tuple[list[dict[str, Any]], dict[str, float]]


def swims_near(
    sets: Sequence[Path], waters: Sequence[Path], processes: int, known: LawError
) -> list[Learned]:
    """``of_robot`` of every robot of some sets."""
    spawn = multiprocessing.get_context("spawn")
    jobs = []
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool:
        for k, one in enumerate(sets):
            answers = json.loads((one / "answers.json").read_text())["cases"]
            for folder in sorted((one / "inputs").glob("robot_*")):
                own = [w / f"{folder.name}.npz" for w in waters[2 * k : 2 * k + 2]]
                files = tuple(path for path in own if path.exists())
                nulls = [
                    c["case"] for c in answers if c["robot"] == folder.name and c["kind"] == "null"
                ]
                jobs.append(pool.submit(of_robot, folder, files, nulls, known))
        return [job.result() for job in tqdm(jobs, disable=None)]


Numbers = dict[str, float]


def sizes(
    swims: list[dict[str, Any]], shares: Array, imitated: Numbers, before: LawError, worth: float
) -> tuple[Array, Numbers]:
    """One round of EM: shares and imitations from what is left of all swims.

    What was known ``before`` counts for ``worth`` swims.
    """
    square: dict[str, list[float]] = {}
    left: list[list[list[float]]] = [[[] for _ in BANDS] for _ in ROWS]
    for one in swims:
        relative = np.array([
            abs(n) if k in RELATIVE else 1.0
            for k, n in zip(one["kinds"], one["nominal"], strict=True)
        ])  # fmt: skip
        own = np.diag(np.square(relative * [imitated[k] for k in one["kinds"]]))
        prior = np.linalg.inv(own + one["spread"])
        gain = own @ prior  # share of what is off that is not the references' uncertainty
        K = one["noise"].shape[1]
        rows = np.minimum(np.arange(K), 3)
        size = shares[rows][:, one["band"]].T
        weight = 1 / np.sqrt(one["noise"] + size**2 * one["power"] + 1e-12)
        slope = one["slope"] * weight.reshape(-1, 1)
        error = one["rows"] * weight.ravel()
        inverse = np.linalg.inv(slope.T @ slope + prior)
        step = -inverse @ (slope.T @ error + prior @ one["off"])
        mean = gain @ (one["off"] + step)
        wide = np.diag(own - gain @ own + gain @ inverse @ gain.T)
        for kind, m, v, r in zip(one["kinds"], mean, wide, relative, strict=True):
            square.setdefault(kind, []).append(float(m**2 + v) / r**2)
        rest = (one["rows"] + one["slope"] @ step).reshape(weight.shape) ** 2
        more = np.sum((one["slope"] @ inverse) * one["slope"], axis=1)
        rest = rest + more.reshape(weight.shape) - one["noise"]
        for k in range(K):
            for b in range(len(BANDS)):
                here = one["band"] == b
                share = np.sum(rest[here, k]) / np.sum(one["power"][here, k])
                left[rows[k]][b].append(float(share))
    fresh = {}
    for kind, values in square.items():
        known = before.imitated[kind]
        kept = np.sort(values)[: int(np.ceil((1 - _WILD) * len(values)))]
        sd = float(np.sqrt((kept.sum() + worth * known**2) / (len(kept) + worth)))
        fresh[kind] = float(np.clip(sd, _LEAST * known, _MOST * known))
    sums, counts = (np.array([[f(cell) for cell in row] for row in left]) for f in (sum, len))
    found = (sums + worth * before.shares**2) / (counts + worth)
    return np.sqrt(np.maximum(found, 1e-6)), fresh


def learned_from(
    robots: Sequence[Learned], before: LawError, seen: Mapping[str, int], *, in_water: bool
) -> dict[str, Any]:
    """What is kept of the twin's error, from swims near their fits and from what was known.

    Args:
        robots: Swims in which nothing is missing, and the law of each robot.
        before: What was known.
        seen: How many ``swims`` and ``robots`` that is from.
        in_water: Whether the fluid puts the twin right.
    """
    swims, laws = [swim for own, _ in robots for swim in own], [law for _, law in robots]
    worth, others = seen["swims"], seen["robots"]
    shares, imitated = before.shares, dict(before.imitated)
    for _ in range(_STEPS):
        shares, fresh = sizes(swims, shares, imitated, before, worth)
        imitated |= fresh
    usual, unknown = {}, {}
    for k in before.unknown:
        own = max(before.unknown[k] ** 2 - before.imitated[k] ** 2, 0.0)
        if k in laws[0]:
            found = np.array([law[k] for law in laws])
            was = (before.shift if in_water else before.usual).get(k, 0.0)
            usual[k] = float((others * was + found.sum()) / (others + len(found)))
            own = _WIDER**2 * np.sum((found - usual[k]) ** 2) + others * (
                own + (_WIDER * (was - usual[k])) ** 2
            )
            own = own / (others + len(found) - 1)
        unknown[k] = float(np.sqrt(own + imitated[k] ** 2))
    return {
        "shares": {
            row: dict(zip(BANDS, map(float, found), strict=True))
            for row, found in zip(ROWS, shares, strict=True)
        },
        "imitated": imitated, "unknown": unknown,
        "usual": {} if in_water else usual, "shift": usual if in_water else {},
        "from": {"swims": worth + len(swims), "robots": others + len(laws)},
    }  # fmt: skip


def main() -> None:
    """Learn, in turns with fits that know what was learned."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("--water", type=Path, nargs="*", default=[], help="two folders a set")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    target = IN_WATER if options.water else FILE
    content = json.loads(target.read_text())
    before = known = read_law_error(target)
    for _ in range(options.turns):
        robots = swims_near(options.sets, options.water, options.processes, known)
        found = learned_from(robots, before, content["from"], in_water=bool(options.water))
        write_json(target, content | found)
        print(json.dumps(found, indent=1))
        known = read_law_error(target)


if __name__ == "__main__":
    main()
