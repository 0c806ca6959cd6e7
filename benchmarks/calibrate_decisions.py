"""Read every number that decides a verdict or a name off cases of development seeds.

    python benchmarks/calibrate_decisions.py ROWS.jsonl --cases 400 --processes 16 --seconds 540
    python benchmarks/calibrate_decisions.py ROWS.jsonl --write

The first makes cases with the generator of ``datasets/concealed`` (it needs numba), one seed a
case, diagnoses them and keeps what was measured of each joint, a line each; what is there already
is not measured again, so that it can be run in pieces. The second reads the numbers off these lines
and writes ``sim2real/diagnose/decision.json`` and ``reports/decisions.json``, the curves they were
read from. No sealed set is looked at. A number with fewer cases behind it than ``FEWEST`` stays as
it was, and says so; one that is a choice ("chosen") is none that data could make.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SEED = 20261122
"""Of the development cases; case k has the seed (SEED, k)."""
KINDS = (("null", 0.3), ("trap", 0.05), ("single", 0.35), ("double", 0.2), ("outside", 0.1))
FEWEST = 20

Row = dict[str, Any]
Reading = tuple[float, int, str, dict[str, list[float]]]
"""A value, how many it was read from, how, and the curve."""


def main() -> None:
    """Measure, or read off and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", type=Path, metavar="ROWS.jsonl")
    parser.add_argument("--cases", type=int, default=400, metavar="N")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    parser.add_argument("--write", action="store_true", help="read off and write decision.json")
    options = parser.parse_args()
    if options.write:
        write(read(options.rows))
    else:
        collect(options.rows, options.cases, options.processes, options.seconds)


def read(path: Path) -> list[Row]:
    """The lines of a file; one that was cut off is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def collect(path: Path, cases: int, processes: int, seconds: float) -> None:
    """Measure the cases that are not in the file yet, until the time is over."""
    deadline = time.perf_counter() + seconds
    known = {row["case"] for row in read(path)}
    left = [k for k in range(cases) if k not in known]
    spawn = multiprocessing.get_context("spawn")
    path.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool, path.open("a") as file:
        waiting, running, done = iter(left), set(), 0
        while True:
            while len(running) < processes and time.perf_counter() < deadline:
                k = next(waiting, None)
                if k is None:
                    break
                running.add(pool.submit(measured, k))
            if not running:
                break
            first = next(as_completed(running))
            running.remove(first)
            file.writelines(json.dumps(row) + "\n" for row in first.result())
            file.flush()
            done += 1
            print(f"{done} of {len(left)} cases", flush=True)


def drawn(k: int) -> tuple[Any, str]:
    """Case ``k`` of the development seeds, and its kind."""
    # Numba imports a ``coverage`` that is not the script of that name beside this one.
    sys.path[:] = [path for path in sys.path if Path(path) != ROOT / "benchmarks"]
    sys.path.insert(0, str(ROOT / "datasets" / "concealed"))
    from cases import draw_case
    from catalogue import EFFECTS
    from outside import OUTSIDERS

    rng = np.random.default_rng([SEED, k])
    names, shares = zip(*KINDS, strict=True)
    kind = str(rng.choice(names, p=shares))
    of = {"single": sorted(EFFECTS), "outside": sorted(OUTSIDERS)}
    of["trap"] = ["wrong_parameters", "clock"]
    name = str(rng.choice(of[kind])) if kind in of else ""
    case, _ = draw_case(kind, name, rng)
    return case, kind


def measured(k: int) -> list[Row]:
    """What is measured of each joint of case ``k``."""
    case, kind = drawn(k)
    from files import write_case

    with tempfile.TemporaryDirectory() as folder:
        write_case(case, "case", Path(folder))
        return _measured(k, kind, case.hidden, Path(folder) / "inputs" / "case")


def _measured(k: int, kind: str, hidden: Sequence[Any], folder: Path) -> list[Row]:
    from sim2real.diagnose.case import Case, by_robot, prepared
    from sim2real.diagnose.investigate import (
        by_evidence,
        investigate,
        link_data,
        nameless_lead,
        size_in_noise,
    )
    from sim2real.effects import named
    from sim2real.link.uneven import links
    from sim2real.model import read_model
    from sim2real.noise import quantization_step
    from sim2real.recording import read_recording
    from sim2real.robot import read_robot
    from sim2real.servo.batch import Batch

    given = folder / "model.json"
    robot = read_robot(folder / "robot.toml")
    recordings = [read_recording(path) for path in sorted(folder.glob("*.csv"))]
    case = Case(recordings, robot, read_model(given) if given.exists() else None)
    joints = prepared(case)
    batch, robots = Batch([joint.traces for joint in joints]), by_robot([joints])
    findings = investigate(batch, joints, robots, rng=np.random.default_rng([SEED, k]))
    fits = [finding.tried.plain for finding in findings], [finding.best for finding in findings]
    alone, beside = links([link_data(batch, joints, robots[0], fit, 0.0) for fit in fits])
    out = []
    for j, (joint, finding) in enumerate(zip(joints, findings, strict=True)):
        tried, best = finding.tried, finding.tried.tried[finding.posterior.sets[0]]
        groups = by_evidence(tried, finding.posterior.groups(tried.base))
        steps = [quantization_step(t.position) for t in joint.traces]
        stated = next(one.servo.position_step_rad for one in robot.joints if one.name == joint.name)
        out.append(
            {
                "case": k,
                "kind": kind,
                "joint": joint.name,
                "truth": [
                    one.effect
                    for one in hidden
                    if one.component in (joint.name, "supply", "link") and kind != "outside"
                ],
                "outside": kind == "outside" and hidden[0].component == joint.name,
                "excess_plain": finding.unmodelled.excess,
                "excess": finding.excess,
                "lead": nameless_lead(tried, best, finding.unmodelled),
                "own": best.evidence - tried.plain.evidence,
                "step": min(steps) / stated if stated > 0 else 0.0,
                "groups": [
                    {
                        "members": group.members,
                        "p": group.probability,
                        "size": size_in_noise(best, group.members[0])
                        if named(group.members[0]).everywhere
                        else None,
                    }
                    for group in groups
                ],
                "link": [
                    {"effect": x.effect, "gain": x.gain, "share": x.shares[j]}
                    for x in (alone, beside)
                ],
            }
        )
    return out


def share(right: Sequence[bool]) -> float:
    """Laplace's rule of succession: never 0 or 1."""
    return (sum(right) + 1) / (len(right) + 2)


def quantile(values: Sequence[float], level: float, why: str) -> Reading:
    """The value that so many stay below; the largest where that is beyond what was seen."""
    x = np.sort(np.asarray(values, dtype=float))
    if not x.size:
        return 0.0, 0, why, {}
    levels = np.linspace(0, 1, 41)
    curve = {"level": levels.tolist(), "value": np.quantile(x, levels).tolist()}
    return float(np.quantile(x, level)), x.size, why, curve


def frequency(right: Sequence[bool], why: str) -> Reading:
    """How often it was so."""
    return share(right), len(right), why, {}


def divide(low: Sequence[float], high: Sequence[float], why: str) -> Reading:
    """Where the two kinds, weighed alike, are told apart best."""
    a, b = np.sort(np.asarray(low, dtype=float)), np.sort(np.asarray(high, dtype=float))
    if not a.size or not b.size:
        return 0.0, 0, why, {}
    tried = np.unique(np.concatenate([a, b]))
    middle = np.concatenate([[tried[0] - 1e-9], (tried[1:] + tried[:-1]) / 2])
    right = np.searchsorted(a, middle) / a.size + 1 - np.searchsorted(b, middle) / b.size
    best = middle[right >= right.max() - 1e-12]
    some = np.linspace(0, middle.size - 1, min(middle.size, 60)).astype(int)
    curve = {"threshold": middle[some].tolist(), "right": (right[some] / 2).tolist()}
    return float(np.median(best)), min(a.size, b.size), why, curve


def readings(rows: Sequence[Row]) -> dict[str, Reading]:
    """Every number that the cases can make."""
    from sim2real.diagnose.decision import DECISION
    from sim2real.effects import CATALOGUE

    nothing = [row for row in rows if row["kind"] in ("null", "trap")]
    inside = [row for row in rows if not row["outside"]]
    for row in rows:
        for group in row["groups"]:
            group["right"] = bool(set(group["members"]) & set(row["truth"]))
    found: dict[str, Reading] = {}
    level = 1 - DECISION.false_alarms
    found["structured"] = quantile(
        [row["excess_plain"] for row in nothing], level, "99 % of joints that miss nothing"
    )
    found["clean"] = quantile(
        [row["excess_plain"] for row in nothing], 0.9, "90 % of joints that miss nothing"
    )
    structured, few = BOUNDS["structured"](found["structured"][0]), _few(inside)
    found["few"] = few
    sure = [g["right"] for row in inside for g in row["groups"][:1] if g["p"] > 0.97]
    found["most_certain"] = frequency(sure, "greatest effects of probability above 0.97: there")
    crowds = [row for row in rows if len(row["groups"]) > few[0]]
    found["of_many"] = frequency([r["groups"][0]["right"] for r in crowds], "greatest of more")
    later = [
        group["right"]
        for row in rows
        for n, group in enumerate(row["groups"])
        if n and (len(row["groups"]) > few[0] or row["excess"] > structured)
    ]
    found["beyond_few"] = frequency(later, "further ones of more, or beside structure: there")
    sizes = [
        g["size"] for row in rows for g in row["groups"] if g["size"] is not None and not g["right"]
    ]
    found["ripple"] = quantile(sizes, level, "99 % of what is named where it was not put in")
    lead, outside = _leads(rows)
    found["nameless_cost"], found["nameless_softness"] = _logistic(lead, outside)
    taken = {
        kind: [
            (row["excess_plain"] - row["excess"]) / (row["excess_plain"] - 1)
            for row in rows
            if row["excess_plain"] > structured and row["outside"] == kind
        ]
        for kind in (True, False)
    }
    found["explained"] = divide(taken[True], taken[False], "outside the catalogue, and in it")
    lost = [row["outside"] for row in rows if _left(row, structured, found["explained"][0])]
    found["nameless"] = frequency(lost, "of what effects leave most of: not in the catalogue")
    chance = ("latency_jitter", "packet_loss")
    quiet = [row for row in inside if not set(row["truth"]) & set(chance)]
    robots = {row["case"]: max(x["gain"] for x in row["link"]) for row in quiet}
    found["link_gain"] = quantile(list(robots.values()), level, "99 % of robots with an even link")
    found["link_shows"] = quantile(
        [row["link"][1]["share"] for row in quiet], 0.95, "95 % of joints with an even link"
    )
    uneven = [row for row in rows if set(row["truth"]) & set(chance) and not row["outside"]]
    ahead = {
        own: [
            row["link"][0]["share"] - row["link"][1]["share"] - row["own"]
            for row in uneven
            if bool(set(row["truth"]) - set(chance)) == own
        ]
        for own in (True, False)
    }
    value, n, why, curve = divide(ahead[True], ahead[False], "joints with effects of their own")
    found["link_tie"] = -value, n, why, curve
    mimics = {(name, effect.name) for effect in CATALOGUE for name in effect.mimics}
    beside = [
        group["right"]
        for row in rows
        for group in row["groups"]
        if any((group["members"][0], name) in mimics for name in row["truth"])
    ]
    found["mimic"] = frequency(beside, "mimicked effects beside the one that mimics them: there")
    coarse = {
        kind: [row["step"] for row in rows if ("encoder_quantization" in row["truth"]) == kind]
        for kind in (True, False)
    }
    found["coarser"] = divide(coarse[False], coarse[True], "sensors as stated, and coarser ones")
    return found


def _few(rows: Sequence[Row]) -> Reading:
    """The most effects of which the last is more often there than not."""
    right = {m: [r["groups"][m - 1]["right"] for r in rows if len(r["groups"]) >= m]
             for m in (1, 2, 3, 4)}  # fmt: skip
    curve = {"effects": [float(m) for m in right], "right": [share(x) for x in right.values()]}
    most = max((m for m, x in right.items() if x and share(x) >= 0.5), default=1)
    return float(most), len(right[1]), "the last of so many is more often there than not", curve


def _left(row: Row, structured: float, explained: float) -> bool:
    more = row["excess_plain"] - 1
    return (
        row["excess_plain"] > structured and row["excess_plain"] - row["excess"] < explained * more
    )


def _leads(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Leads of smooth functions on joints that miss something, and whether it has no name."""
    some = [row for row in rows if row["outside"] or row["truth"]]
    lead = np.array([row["lead"] for row in some])
    return lead, np.array([row["outside"] for row in some], dtype=bool)


def _logistic(lead: np.ndarray, outside: np.ndarray) -> tuple[Reading, Reading]:
    """Place and width of the logistic curve from catalogue to none, both weighed alike."""
    from scipy.optimize import minimize

    n = int(min(outside.sum(), (~outside).sum()))
    if n < 2:
        return (0.0, n, "", {}), (0.0, n, "", {})
    weight = np.where(outside, 0.5 / outside.mean(), 0.5 / (~outside).mean())
    sign = np.where(outside, -1.0, 1.0)

    def loss(x: np.ndarray) -> float:
        z = np.clip((lead - x[0]) / np.exp(x[1]), -60, 60)
        return float(np.mean(weight * np.logaddexp(0.0, sign * z)))

    starts = [(place, np.log(5.0)) for place in (0.0, 10.0, 30.0)]
    best = min((minimize(loss, x, method="Nelder-Mead") for x in starts), key=lambda r: r.fun)
    edges = np.quantile(lead, np.linspace(0, 1, 13))
    bins = np.clip(np.searchsorted(edges, lead) - 1, 0, 11)
    filled = [b for b in range(12) if (bins == b).any()]
    curve = {
        "lead": [float(lead[bins == b].mean()) for b in filled],
        "outside": [float(outside[bins == b].mean()) for b in filled],
    }
    why = "logistic curve of physics outside the catalogue over the lead of smooth functions"
    softness = float(np.clip(np.exp(best.x[1]), 1.0, 50.0))
    return (float(best.x[0]), n, why, curve), (softness, n, why, {})


BOUNDS: dict[str, Callable[[float], float]] = {
    "structured": lambda x: max(x, 1.05),
    "clean": lambda x: max(x, 1.02),
    "most_certain": lambda x: min(x, 0.99),
    "explained": lambda x: float(np.clip(x, 0.2, 0.9)),
    "ripple": lambda x: max(x, 0.3),
    "link_gain": lambda x: max(x, 5.0),
    "link_shows": lambda x: max(x, 2.0),
    "link_tie": lambda x: float(np.clip(x, 0.0, 20.0)),
    "nameless_cost": lambda x: max(x, 0.0),
    "coarser": lambda x: float(np.clip(x, 1.2, 3.0)),
}
"""What no small sample may push a number beyond."""


def write(rows: Sequence[Row]) -> None:
    """Write decision.json and the curves."""
    target = ROOT / "sim2real" / "diagnose" / "decision.json"
    content = json.loads(target.read_text())
    cases = len({row["case"] for row in rows})
    curves = {}
    for name, (value, n, why, curve) in readings(rows).items():
        entry, before = content["values"][name], content["values"][name]["value"]
        if n < FEWEST:
            entry["from"] = f"kept: {n} cases are too few"
            continue
        value = float(f"{BOUNDS.get(name, float)(value):.3g}")
        entry.update({"value": value, "from": f"{why}; {n} of {cases} cases"})
        curves[name] = {"value": value, "before": before, "count": n, "how": why, "curve": curve}
    content["made_by"] = "benchmarks/calibrate_decisions.py"
    content["seed"], content["cases"] = SEED, cases
    order = ("schema", "made_by", "seed", "cases", "values")
    target.write_text(json.dumps({key: content[key] for key in order}, indent=1) + "\n")
    report = {"seed": SEED, "cases": cases, "joints": len(rows), "readings": curves}
    (ROOT / "reports" / "decisions.json").write_text(json.dumps(report, indent=1) + "\n")
    for name, one in curves.items():
        print(f"{name:18s} {one['before']:8.3g} -> {one['value']:8.3g}   {one['count']}")


if __name__ == "__main__":
    main()
