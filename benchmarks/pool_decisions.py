"""Read what decides a diagnosis of swims off a development set: the twin's error, the thresholds.

    python benchmarks/pool_decisions.py learn SET [SET ...] [--water INPUTS HELD_OUT ...]
    python benchmarks/pool_decisions.py choose SET VERDICTS [SET VERDICTS ...] [--in-water]

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
from collections.abc import Sequence
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
    SCHEMA,
    LawError,
    read_law_error,
)
from sim.inference.searched import learned
from sim.inference.swim_decision import Decided, decide, strange_terms, terms_of
from sim.inference.swims import swim_of
from sim.inference.twin_search import Belief, TwinSwims
from sim2real.model import Model, read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot

Array = NDArray[np.float64]

GUESS = Path(__file__).with_name("pool_guess.json")
"""Where learning begins, by hand: what few swims know nothing of stays near it."""
GUESS_IN_WATER = Path(__file__).with_name("pool_guess_in_water.json")
"""The same of a twin that the fluid puts right: a third of it."""
Files = tuple[Path, ...]
_STEPS = 20
_LEAST, _MOST = 0.15, 3.5
"""Of a guess, between which an imitation stays: columns that all but cancel would run away."""
_WORTH, _WILD = 10.0, 0.1
"""Swims that the guess counts for; share of the largest that is left out."""


def placed(folder: Path, files: Files) -> tuple[Robot, Model, Swum, LawError]:
    """A robot, its model, its simulator, and where learning of its error begins."""
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    model, simulate = robot_in_water(robot, model, files, threads=1)
    return robot, model, simulate, read_law_error(GUESS_IN_WATER if files else GUESS)


def law(folder: Path, files: Files, without: str = "") -> Belief:
    """What a robot's references say of its law, one of them left out if asked."""
    robot, model, simulate, known = placed(folder, files)
    paths = [p for p in sorted(folder.glob("ref_*.csv")) if p.name != without]
    references = [swim_of(read_recording(p), robot) for p in paths]
    return replace(learned(references, model, robot, simulate, known), shares=known.shares)


def linear(folder: Path, path: Path, belief: Belief, files: Files) -> dict[str, Any]:
    """A swim in which nothing is missing, near its fit."""
    robot, model, simulate, _ = placed(folder, files)
    c = Coordinates.of(robot, model)
    swim = swim_of(read_recording(path), robot)
    problem = TwinSwims(c, [swim], simulate, belief)
    fit = problem.plain().fit
    weight = problem.weights[0].ravel()
    blocks: Blocks = problem.blocks[0]
    return {
        "rows": (fit.rows / weight).astype(np.float32),
        "slope": (fit.near.slope / weight[:, None]).astype(np.float32),
        "off": fit.x - problem.centre(frozenset()),
        "noise": blocks.noise, "power": blocks.power, "band": blocks.band,
        "kinds": [one.kind for one in c.columns], "nominal": [one.nominal for one in c.columns],
        "robot": str(folder),
    }  # fmt: skip


def of_robot(folder: Path, files: Files, nulls: list[str]) -> Learned:
    """A robot's swims in which nothing is missing, each near its fit, and its law."""
    challenge = folder.parents[1]
    whole = law(folder, files)
    swims = [
        linear(folder, folder / f"ref_{n}.csv", law(folder, files, f"ref_{m}.csv"), files)
        for n, m in ((1, 1), (2, 2))
    ]
    for case in nulls:
        held = challenge / "heldout" / case / "b.csv"
        for path in (folder / case / "a.csv", *([held] if len(files) != 1 else [])):
            if path.exists():
                swims.append(linear(folder, path, whole, files))
    robot, model, *_ = placed(folder, files)
    c = Coordinates.of(robot, model)
    means = zip((c.columns[k] for k in c.base), whole.mean, strict=True)
    return swims, {
        one.kind: float(v) - (one.nominal if files else 0.0)
        for one, v in means
        if not one.kind.startswith("servo")
    }


Learned = tuple[list[dict[str, Any]], dict[str, float]]


def swims_near(sets: Sequence[Path], waters: Sequence[Path], processes: int) -> list[Learned]:
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
                jobs.append(pool.submit(of_robot, folder, files, nulls))
        return [job.result() for job in tqdm(jobs, disable=None)]


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


def learn(sets: Sequence[Path], waters: Sequence[Path], processes: int, cache: Path) -> None:
    """The twin's error from swims in which nothing is missing."""
    if not cache.exists():
        cache.parent.mkdir(exist_ok=True)
        cache.write_bytes(pickle.dumps(swims_near(sets, waters, processes)))
    robots: list[Learned] = pickle.loads(cache.read_bytes())
    swims, laws = [swim for own, _ in robots for swim in own], [law for _, law in robots]
    target = IN_WATER if waters else FILE
    guess = read_law_error(GUESS_IN_WATER if waters else GUESS)
    content = json.loads((target if target.exists() else FILE).read_text())
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
        "imitated": imitated, "unknown": unknown,
        "usual": {} if waters else usual, "shift": usual if waters else {},
        "from": f"{len(swims)} swims of {len(laws)} robots in which nothing is missing, of "
        f"{len(sets)} sets of datasets/pool/sealed.py",
    }  # fmt: skip
    write_json(target, content)
    print(
        json.dumps(
            {k: content[k] for k in ("shares", "imitated", "unknown", "usual", "shift")}, indent=1
        )
    )


SPANS: dict[str, tuple[float, float]] = {
    "cost": (0.0, 12.0), "temperature": (1.0, 8.0), "something": (0.5, 0.9999),
    "something alone": (0.5, 0.9999),
    "alike": (0.5, 6.0), "alike_imitated": (0.5, 8.0), "held_better": (0.03, 0.3),
    "held_sure": (5.0, 200.0), "held_gain": (-3.0, 5.0), "held_worse": (0.0, 0.05),
    "most_certain": (0.95, 0.99),
}  # fmt: skip
"""Where thresholds are looked for."""
_LOOKS, _NARROW, _AT_ONCE = 120, 0.2, 3
_FOLDS = 5
_SPREADS, _COVERED = np.arange(0.0, 0.41, 0.01), 0.88
_RIDGE = 1.0
_USUAL = 0.85
"""Of cases of the catalogue, that leave no more than what counts as usual."""
Cases = list[tuple[dict[str, Any], dict[str, Any]]]


def judged(cases: list[tuple[dict[str, Any], Decided]]) -> dict[str, float]:
    """The grader's measures of (answer, decision) pairs."""
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
    for truth, said in cases:
        hidden = _hidden(truth)
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


def _hidden(truth: dict[str, Any]) -> list[tuple[str, str]]:
    outside = truth["kind"] == "outside"
    return [] if outside else [(e["effect"], e["component"]) for e in truth["effects"]]


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
        - max(0.0, found["flagged_null"] - 0.05)
    )  # fmt: skip


def usually(cases: Cases) -> Numbers:
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


def choose(sets: Sequence[Path], verdicts: Sequence[Path], target: Path) -> None:
    """Thresholds whose answers to the development set are best, by a random search that narrows."""
    cases = []
    for challenge, place in zip(sets, verdicts, strict=True):
        for one in json.loads((challenge / "answers.json").read_text())["cases"]:
            path = place / one["case"] / "raw.json"
            if path.exists():
                truth = one | {"robot": f"{challenge.name} {one['robot']}"}
                found = json.loads(path.read_text()) | {"referred": one["references"]}
                cases.append((truth, found))
    content = json.loads(target.read_text())
    robots = sorted({truth["robot"] for truth, _ in cases})
    out = [set(robots[k::_FOLDS]) for k in range(_FOLDS)]
    parts = [[c for c in cases if c[0]["robot"] not in some] for some in out]
    begun = [content["decisions"]] * (_FOLDS + 1)
    with ProcessPoolExecutor(_AT_ONCE) as pool:
        *found, best = pool.map(tuned, [*parts, cases], begun)
    apart = [
        (t, decide(f, numbers))
        for numbers, some in zip(found, out, strict=True)
        for t, f in cases
        if t["robot"] in some
    ]
    print(len(cases), "cases of", len(robots), "robots; robots left out:", judged(apart))
    best["relative"] = spread_of(sets, verdicts)
    content["decisions"] = {k: float(f"{v:.4g}") for k, v in best.items()}
    content["decided"] = f"{len(cases)} cases of {len(robots)} robots, {_LOOKS} looks at random"
    write_json(target, content)
    print("all:", judged([(t, decide(f, best)) for t, f in cases]))


def spread_of(sets: Sequence[Path], verdicts: Sequence[Path]) -> float:
    """What estimates are off by beyond their own sd, of their size: then 90 % hold the truth.

    Of verdicts whose intervals had no such spread, and of effects that were named exactly.
    """
    rows = []
    for challenge, place in zip(sets, verdicts, strict=True):
        for one in json.loads((challenge / "answers.json").read_text())["cases"]:
            path = place / one["case"] / "diagnosis.json"
            hidden = {(e["effect"], e["component"]): e["parameters"] for e in one["effects"]}
            for said in json.loads(path.read_text())["effects"] if path.exists() else ():
                for name, true in hidden.get((said["effect"], said["component"]), {}).items():
                    told = said["parameters"].get(name)
                    if told:
                        rows.append((true - told["mean"], told["sd"], told["mean"]))
    off, sd, size = np.array(rows).T
    for relative in _SPREADS:
        if np.mean(np.abs(off) <= 1.645 * np.hypot(sd, relative * size)) >= _COVERED:
            break
    return float(relative)


def tuned(cases: Cases, begun: Numbers) -> Numbers:
    """Numbers that decide best: curves of odds, and thresholds by a random search that narrows."""
    rng = np.random.default_rng(0)
    own = ("odds", "strange")
    best = {k: v for k, v in begun.items() if not k.startswith(own)} | usually(cases)
    best = curves(cases, best)
    for turn in range(2):
        top = worth(judged([(t, decide(f, best)) for t, f in cases]))
        for look in range(_LOOKS):
            wide = look < _LOOKS // 6 and turn == 0
            trial = dict(best)
            for name, (low, high) in SPANS.items():
                drawn = rng.uniform(low, high)
                if not wide and rng.random() < 0.6:
                    drawn = best[name]
                elif not wide:
                    drawn = best[name] + _NARROW * (drawn - (low + high) / 2)
                trial[name] = float(np.clip(drawn, low, high))
            got = worth(judged([(t, decide(f, trial)) for t, f in cases]))
            if got > top:
                top, best = got, trial
        best = curves(cases, best)
    return best


def curves(cases: Cases, numbers: Numbers) -> Numbers:
    """Weights of both logistic curves: of something that the catalogue lacks, and of names."""
    flat = {f"{which} {k}": 0.0 for which in ("odds", "strange") for k in range(11)}
    said = [(truth, decide(found, flat | numbers)) for truth, found in cases]
    strange = logistic(
        [strange_terms(one.strange) for _, one in said],
        [truth["kind"] == "outside" for truth, _ in said],
    )
    out = {k: v for k, v in numbers.items() if not k.startswith(("odds", "strange"))}
    out |= {f"strange {k}": v for k, v in enumerate(strange)}
    said = [(truth, decide(found, flat | out)) for truth, found in cases]
    names = [(truth, one) for truth, each in said for one in each.named]
    odds = logistic(
        [terms_of(one.spoken) for _, one in names],
        [_right(one.group, _hidden(truth)) for truth, one in names],
    )
    return out | {f"odds {k}": v for k, v in enumerate(odds)}


def logistic(terms: Sequence[Sequence[float]], right: Sequence[bool]) -> list[float]:
    """Weights by ridge regression."""
    X, y = np.array(terms), np.array(right, dtype=np.float64)
    size = np.maximum(X.std(axis=0), 1e-3)
    size[0] = 1.0
    X = X / size
    penalty = _RIDGE * np.eye(X.shape[1])
    penalty[0, 0] = 1e-3
    w = np.zeros(X.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(X @ w, -30, 30)))
        slope = X.T @ (p - y) + penalty @ w
        curve = (X * (p * (1 - p))[:, None]).T @ X + penalty
        w = w - np.linalg.solve(curve, slope)
    return [float(v) for v in w / size]


def main() -> None:
    """Learn or choose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("learn")
    one.add_argument("sets", type=Path, nargs="+")
    one.add_argument("--water", type=Path, nargs="*", default=[], help="two folders for each set")
    one.add_argument("--processes", type=int, default=2)
    one.add_argument("--cache", type=Path, required=True, help="what the swims said is kept there")
    two = commands.add_parser("choose")
    two.add_argument("sets", type=Path, nargs="+", help="sets and verdicts in turns")
    two.add_argument("--in-water", action="store_true")
    options = parser.parse_args()
    if options.command == "learn":
        learn(options.sets, options.water, options.processes, options.cache)
    else:
        choose(options.sets[::2], options.sets[1::2], IN_WATER if options.in_water else FILE)


if __name__ == "__main__":
    main()
