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
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.inference.blocks import Blocks
from sim.inference.coordinates import Coordinates
from sim.inference.followed import by_followed_twin
from sim.inference.law_error import BANDS, FILE, RELATIVE, ROWS, SCHEMA, read_law_error
from sim.inference.searched import learned
from sim.inference.swim_decision import decide
from sim.inference.swims import swim_of
from sim.inference.twin_search import Belief, TwinSwims
from sim2real.model import read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import read_robot

Array = NDArray[np.float64]

GUESS = Path(__file__).with_name("pool_guess.json")
"""Where learning begins, by hand: what few swims know nothing of stays near it."""
_STEPS = 20
_LEAST, _MOST = 0.15, 3.5
"""Of a guess, between which an imitation stays: columns that all but cancel would run away."""
_WORTH, _WILD = 10.0, 0.1
"""Swims that the guess counts for; share of the largest that is left out."""


def law(folder: Path, without: str = "") -> Belief:
    """What a robot's references say of its law, one of them left out if asked."""
    known = read_law_error(GUESS)
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    paths = [p for p in sorted(folder.glob("ref_*.csv")) if p.name != without]
    references = [swim_of(read_recording(p), robot) for p in paths]
    belief = learned(references, model, robot, by_followed_twin(robot, threads=1), known)
    return replace(belief, shares=known.shares)


def linear(folder: Path, path: Path, belief: Belief) -> dict[str, Any]:
    """A swim in which nothing is missing, near its fit."""
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    c = Coordinates.of(robot, model)
    swim = swim_of(read_recording(path), robot)
    problem = TwinSwims(c, [swim], by_followed_twin(robot, threads=1), belief)
    fit = problem.plain().fit
    weight = problem.weights[0].ravel()
    blocks: Blocks = problem.blocks[0]
    return {
        "rows": (fit.rows / weight).astype(np.float32),
        "slope": (fit.near.slope / weight[:, None]).astype(np.float32),
        "off": fit.x - problem.centre(frozenset()),
        "noise": blocks.noise, "power": blocks.power, "band": blocks.band,
        "kinds": [one.kind for one in c.columns], "nominal": [one.nominal for one in c.columns],
        "size": np.sqrt(np.mean(swim.signals**2, axis=0)),
    }  # fmt: skip


def swims_near(
    development: Path, processes: int
) -> tuple[list[dict[str, Any]], list[dict[str, float]]]:
    """All swims in which nothing is missing, each near its fit, and the robots' laws."""
    answers = json.loads((development / "answers.json").read_text())
    folders = sorted((development / "inputs").glob("robot_*"))
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool:
        whole = {f: pool.submit(law, f) for f in folders}
        parts = {(f, n): pool.submit(law, f, f"ref_{n}.csv") for f in folders for n in (1, 2)}
        jobs = [
            pool.submit(linear, f, f / f"ref_{n}.csv", part.result())
            for (f, n), part in parts.items()
        ]
        for case in answers["cases"]:
            if case["kind"] == "null":
                f = development / "inputs" / case["robot"]
                belief = whole[f].result()
                jobs.append(pool.submit(linear, f, f / case["case"] / "a.csv", belief))
                held = development / "heldout" / case["case"] / "b.csv"
                if held.exists():
                    jobs.append(pool.submit(linear, f, held, belief))
        swims = [job.result() for job in jobs]
        laws = []
        for f, found in whole.items():
            c = Coordinates.of(read_robot(f / "robot.toml"), read_model(f / "model.json"))
            means = zip((c.columns[k].kind for k in c.base), found.result().mean, strict=True)
            laws.append({k: float(v) for k, v in means if k.startswith("twin")})
    return swims, laws


Numbers = dict[str, float]


def sizes(
    swims: list[dict[str, Any]], shares: Array, imitated: Numbers, guess: Numbers
) -> tuple[Array, Numbers]:
    """One round of EM: shares and imitations from what is left of all swims."""
    square: dict[str, list[float]] = {}
    left: list[list[list[float]]] = [[[] for _ in BANDS] for _ in ROWS]
    for one in swims:
        relative = np.array([
            abs(n) if k in RELATIVE else 1.0
            for k, n in zip(one["kinds"], one["nominal"], strict=True)
        ])  # fmt: skip
        prior = np.diag(1 / np.square(relative * [imitated[k] for k in one["kinds"]]))
        K = one["noise"].shape[1]
        rows = np.minimum(np.arange(K), 3)
        size = shares[rows][:, one["band"]].T
        weight = 1 / np.sqrt(one["noise"] + size**2 * one["power"] + 1e-12)
        slope = one["slope"] * weight.reshape(-1, 1)
        error = one["rows"] * weight.ravel()
        inverse = np.linalg.inv(slope.T @ slope + prior)
        step = -inverse @ (slope.T @ error + prior @ one["off"])
        mean = one["off"] + step
        for kind, m, v, r in zip(one["kinds"], mean, np.diag(inverse), relative, strict=True):
            square.setdefault(kind, []).append(float(m**2 + v) / r**2)
        rest = (one["rows"] + one["slope"] @ step).reshape(weight.shape) ** 2
        more = np.einsum("nf,fg,ng->n", one["slope"], inverse, one["slope"])
        rest = rest + more.reshape(weight.shape) - one["noise"]
        for k in range(K):
            for b in range(len(BANDS)):
                here = one["band"] == b
                share = np.sum(rest[here, k]) / np.sum(one["power"][here, k])
                left[rows[k]][b].append(float(share))
    fresh = {}
    for kind, values in square.items():
        kept = np.sort(values)[: int(np.ceil((1 - _WILD) * len(values)))]
        own = float(kept.sum()) + _WORTH * guess[kind] ** 2
        size = float(np.sqrt(own / (len(kept) + _WORTH)))
        most = _MOST * (2 if kind == "added_mass.ratio" else 1)
        fresh[kind] = float(np.clip(size, _LEAST * guess[kind], most * guess[kind]))
    found = np.array([[np.mean(cell) for cell in row] for row in left])
    return np.sqrt(np.maximum(found, 1e-6)), fresh


def learn(development: Path, processes: int) -> None:
    """The twin's error from swims in which nothing is missing."""
    cache = development / "private" / "linear.pickle"
    if not cache.exists():
        cache.parent.mkdir(exist_ok=True)
        cache.write_bytes(pickle.dumps(swims_near(development, processes)))
    swims, laws = pickle.loads(cache.read_bytes())
    content = json.loads(FILE.read_text())
    guess = read_law_error(GUESS)
    shares, guessed = guess.shares, dict(guess.imitated)
    imitated = dict(guessed)
    for _ in range(_STEPS):
        shares, fresh = sizes(swims, shares, imitated, guessed)
        imitated |= fresh
    usual = {k: float(np.mean([law[k] for law in laws])) for k in laws[0]}
    unknown = dict(guess.unknown)
    for k in usual:
        spread = float(np.std([law[k] for law in laws], ddof=1))
        unknown[k] = float(np.hypot(1.3 * spread, imitated[k]))
    for k in [k for k in unknown if k.startswith("servo")]:
        unknown[k] = float(np.hypot(unknown[k], imitated[k]))
    content |= {
        "schema": SCHEMA,
        "shares": {
            row: dict(zip(BANDS, map(float, found), strict=True))
            for row, found in zip(ROWS, shares, strict=True)
        },
        "imitated": imitated, "unknown": unknown, "usual": usual,
        "from": f"{len(swims)} swims of {len(laws)} robots in which nothing is missing, of a "
        "development set of datasets/pool/sealed.py (seed 20)",
    }  # fmt: skip
    write_json(FILE, content)
    print(json.dumps({k: content[k] for k in ("shares", "imitated", "unknown", "usual")}, indent=1))


SPANS: dict[str, tuple[float, float]] = {
    "cost": (2.0, 14.0), "temperature": (1.0, 8.0), "alike": (0.5, 6.0),
    "alike_imitated": (1.0, 12.0), "unlisted": (-5.0, 40.0), "unlisted_softness": (1.0, 4.0),
    "misfit": (-0.3, 2.0), "misfit_softness": (0.05, 0.15), "held_better": (0.03, 0.3),
    "held_sure": (15.0, 200.0), "held_gain": (-3.0, 5.0),
    "held_worse": (0.0, 0.02), "most_certain": (0.95, 0.99),
}  # fmt: skip
"""Where thresholds are looked for."""
_LOOKS, _NARROW = 2400, 0.2
_USUAL = 0.85
"""Of cases of the catalogue, that leave no more than what counts as usual."""


def judged(
    cases: list[tuple[dict[str, Any], dict[str, Any]]], numbers: dict[str, float]
) -> dict[str, float]:
    """The grader's measures of decisions with these numbers, of (answer, raw) pairs."""
    counts: dict[str, list[float]] = {
        k: []
        for k in (
            "false_alarm",
            "flagged_null",
            "detection",
            "group_first",
            "both",
            "abstains",
            "wrong",
        )
    }
    stated: list[tuple[float, bool]] = []
    for truth, found in cases:
        said = decide(found, numbers)
        hidden = (
            []
            if truth["kind"] == "outside"
            else [(e["effect"], e["component"]) for e in truth["effects"]]
        )
        right = [_right(one.group, hidden) for one in said.named]
        stated += [
            (one.probability, ok)
            for one, ok in zip(said.named, right, strict=True)
            if one.probability >= 0.05
        ]
        sure = [ok for one, ok in zip(said.named, right, strict=True) if one.probability >= 0.9]
        counts["wrong"] += [float(not ok) for ok in sure]
        likely = [one for one in said.named if one.probability >= 0.5]
        flagged = said.verdict != "consistent"
        seen = truth["oracle"]["llr_total"] >= 10
        if truth["kind"] == "null":
            counts["false_alarm"].append(float(bool(sure)))
            counts["flagged_null"].append(float(flagged))
        if truth["kind"] == "outside":
            good = said.verdict in ("unexplained", "partly_explained") and not likely
            counts["abstains"].append(float(good))
        if truth["kind"] in ("single", "double") and seen:
            counts["detection"].append(float(flagged))
        if truth["kind"] == "single" and seen:
            counts["group_first"].append(float(bool(right) and right[0]))
        if truth["kind"] == "double" and seen:
            met = sum(any(_right(one.group, [h]) for one in likely) for h in hidden)
            counts["both"].append(float(met == 2 and len(likely) == 2))
    out = {name: float(np.mean(v)) if v else 0.0 for name, v in counts.items()}
    p, ok = np.array([x for x, _ in stated]), np.array([float(y) for _, y in stated])
    place = np.minimum((10 * p).astype(int), 9)
    out["ece"] = float(
        sum(abs(p[place == k].sum() - ok[place == k].sum()) for k in range(10)) / max(len(p), 1)
    )
    return out


def _right(group: Any, hidden: list[tuple[str, str]]) -> bool:  # noqa: ANN401
    alone = len({name for name, _ in group}) == 1
    return any(
        (name == effect and (not alone or of == where))
        for name, of in group
        for effect, where in hidden
    )


def worth(found: dict[str, float]) -> float:
    """What measures are worth: those of the issue, false names dearest."""
    over = lambda name, bar: max(0.0, found[name] - bar)  # noqa: E731
    return (
        found["detection"] + found["group_first"] + 0.8 * found["both"] + found["abstains"]
        - 6 * over("false_alarm", 0.0) - 4 * over("wrong", 0.015) - 3 * over("ece", 0.05)
        - max(0.0, found["flagged_null"] - 0.3)
    )  # fmt: skip


def usually(cases: list[tuple[dict[str, Any], dict[str, Any]]]) -> Numbers:
    """What is left, and shapes without a name bring, where the catalogue has all there is."""
    inside = [found for truth, found in cases if truth["kind"] != "outside"]
    shapes: dict[str, list[float]] = {}
    for found in inside:
        own: dict[str, float] = {}
        for shape, gain in found["nameless"]["best"].items():
            family = f"usual {shape.split()[0]}"
            own[family] = max(own.get(family, -np.inf), gain)
        for family, gain in own.items():
            shapes.setdefault(family, []).append(gain)
    misfit = np.quantile([found["misfit"] for found in inside], _USUAL, axis=0)
    return {
        **{family: float(np.quantile(gains, _USUAL)) for family, gains in shapes.items()},
        **{f"usual misfit {k} {b}": float(misfit[k, b]) for k in range(4) for b in range(3)},
    }


def choose(development: Path, places: list[Path]) -> None:
    """Thresholds whose answers to the development set are best, by a random search that narrows."""
    answers = json.loads((development / "answers.json").read_text())["cases"]
    cases = []
    for one in answers:
        found = [place / one["case"] / "raw.json" for place in places]
        found = [path for path in found if path.exists()]
        if found:
            cases.append((one, json.loads(found[0].read_text())))
    rng = np.random.default_rng(0)
    content = json.loads(FILE.read_text())
    best = dict(content["decisions"]) | usually(cases)
    top = worth(judged(cases, best))
    print(len(cases), "cases; before", judged(cases, best))
    for look in range(_LOOKS):
        near = _NARROW if look > _LOOKS // 6 else 1.0
        trial = dict(best)
        for name, (low, high) in SPANS.items():
            drawn = rng.uniform(low, high)
            if near < 1 and rng.random() < 0.6:
                drawn = best[name]
            elif near < 1:
                drawn = float(np.clip(best[name] + near * (drawn - (low + high) / 2), low, high))
            trial[name] = float(drawn)
        got = worth(judged(cases, trial))
        if got > top:
            top, best = got, trial
    content["decisions"] = {k: float(f"{v:.4g}") for k, v in best.items()}
    content["decided"] = f"{len(cases)} cases of the development set, {_LOOKS} looks at random"
    write_json(FILE, content)
    print("after", judged(cases, best), best)


def main() -> None:
    """Learn or choose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("learn")
    one.add_argument("development", type=Path)
    one.add_argument("--processes", type=int, default=2)
    two = commands.add_parser("choose")
    two.add_argument("development", type=Path)
    two.add_argument("verdicts", type=Path, nargs="+", help="the first that has a case counts")
    options = parser.parse_args()
    if options.command == "learn":
        learn(options.development, options.processes)
    else:
        choose(options.development, options.verdicts)


if __name__ == "__main__":
    main()
