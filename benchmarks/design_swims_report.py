"""Accuracy of diagnoses of second swims: measures of each arm of ``design_swims.py``, and cases."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from knower import known_to
from sealed import component
from sealed_grade import DETECTABLE, LIKELY, SURE, servo_grader
from tqdm import tqdm

from benchmarks.design_swims_cases import Bench
from benchmarks.pool_decisions import Cases, matches
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array
from sim2real.output import write_json
from sim2real.velocity import body_velocity

Row = dict[str, Any]

SWIMS = {"first": ("first",), "usual": ("first", "usual"), "designed": ("first", "designed")}
"""The swims that each arm's diagnosis has seen."""
RESISTANCES = {
    "linear_drag": "drag", "form_drag": "drag", "surface_friction": "friction",
    "added_mass": "added mass",
}  # fmt: skip


def evidence(bench: Bench, k: int, name: str) -> list[float]:
    """Log-likelihood ratio of each effect of a case, in one swim, of one who knows the plant.

    The size of the other effect is not known to them: what its presence changes is a direction
    that counts as nothing.
    """
    case, kept = bench.cases[k], np.load(bench.path(k, f"{name}.npz"))
    pose, joint, sent = (kept[key].astype(np.float64) for key in ("pose", "joint", "sent"))
    t = CONTROL_S * np.arange(len(sent))
    signals = [
        np.concatenate([body_velocity(t, p), j], axis=1) for p, j in zip(pose, joint, strict=True)
    ]
    out = []
    for left in range(1, 1 + len(case.effects)):
        unknown = [signals[left] - signals[-1]] if len(case.effects) > 1 else []
        told = known_to(
            t, pose[0], joint[0], pose[left], joint[left], sent, case, bench.drawn, bench.model,
            unknown,
        )  # fmt: skip
        out.append(told["llr_total"])
    return out


def rows_of(benches: Sequence[Bench]) -> list[Row]:
    """All cases of which both pairs of swims were diagnosed."""
    rows = []
    todo = [
        (bench, k)
        for bench in benches
        for k in bench.complete(*(f"{arm}_row.json" for arm in SWIMS))
    ]
    for bench, k in tqdm(todo, disable=None):
        row: Row = json.loads(bench.path(k, "first_row.json").read_text())
        for arm in ("usual", "designed"):
            row[arm] = json.loads(bench.path(k, f"{arm}_row.json").read_text())
        row["evidence"] = {name: evidence(bench, k, name) for name in SWIMS}
        rows.append(row)
    return rows


def decision_cases(benches: Sequence[Bench]) -> Cases:
    """Answers and searches of all diagnoses, of one swim and of two, for ``pool_decisions``."""
    cases = []
    for row in rows_of(benches):
        for arm in SWIMS:
            truth = {
                "robot": row["case"].partition(".")[0], "kind": row["kind"], "held_out": None,
                "effects": [{"effect": name, "component": of} for name, of in hidden(row)],
                "oracle": {"llr_total": float(np.max(shown_by(row, arm), initial=0.0))},
            }  # fmt: skip
            cases.append((truth, row[arm]["raw"] | {"referred": True}))
    return cases


def hidden(row: Row) -> list[tuple[str, str]]:
    """Effects of a case and their components, sorted."""
    return sorted((name.partition(".")[0], component(name)) for name in row["effects"])


def shown_by(row: Row, arm: str) -> Array:
    """Evidence of each effect of a case, in all swims of an arm together."""
    return np.sum([row["evidence"][name] for name in SWIMS[arm]], axis=0)


def separable(row: Row, arm: str) -> bool:
    """Whether one who knows the plant can tell from the swims of an arm that either is missing."""
    return bool(np.min(shown_by(row, arm)) >= DETECTABLE)


def names(row: Row, arm: str) -> list[Row]:
    """What a diagnosis names, with whether it is right, see ``pool_decisions.matches``."""
    return [{**one, "right": matches(one["group"], hidden(row))} for one in row[arm]["named"]]


def both(row: Row, arm: str) -> bool:
    """Whether two names are likely, each effect in one of them."""
    likely = [one for one in names(row, arm) if one["probability"] >= LIKELY]
    return len(likely) == 2 and all(
        any(matches(one["group"], [effect]) for one in likely) for effect in hidden(row)
    )


def told_apart(row: Row, arm: str) -> bool:
    """Whether each resistance of a case is found, in a group without one of another kind."""
    likely = [one["group"] for one in names(row, arm) if one["probability"] >= LIKELY]
    return all(
        any(
            matches(group, [(name, of)])
            and {RESISTANCES.get(other, RESISTANCES[name]) for other, _ in group}
            == {RESISTANCES[name]}
            for group in likely
        )
        for name, of in hidden(row)
        if name in RESISTANCES
    )


def measures(rows: Sequence[Row], arm: str) -> Row:
    """Shares of an arm, as the servos' grader states them, and means."""
    grader = servo_grader()
    nulls, singles, doubles = (
        [r for r in rows if r["kind"] == kind] for kind in ("null", "single", "double")
    )
    seen = [r for r in singles + doubles if np.max(shown_by(r, arm)) >= DETECTABLE]
    apart = [r for r in doubles if separable(r, arm)]
    entries = [one for r in rows for one in names(r, arm)]
    sure = lambda r: [one for one in names(r, arm) if one["probability"] >= SURE]  # noqa: E731
    flagged = lambda some: grader.share(r[arm]["verdict"] != "consistent" for r in some)  # noqa: E731
    p = [np.array([x for _, x in r[arm]["sets"]]) for r in rows]
    true = [
        sum(x for s, x in r[arm]["sets"] if [tuple(one) for one in s] == hidden(r)) for r in rows
    ]
    return {
        "a name at 0.9 where nothing is missing": grader.share(bool(sure(r)) for r in nulls),
        "flagged where nothing is missing": flagged(nulls),
        "detectable effects flagged": flagged(seen),
        "right group first, one effect": grader.share(
            bool(one := names(r, arm)) and one[0]["right"] for r in singles if r in seen
        ),
        "both of two": grader.share(both(r, arm) for r in doubles),
        "both of two, separable pairs": grader.share(both(r, arm) for r in apart),
        "both of two, pairs separable after the designed swim": grader.share(
            both(r, arm) for r in doubles if separable(r, "designed")
        ),
        "resistance told apart, separable pairs with one": grader.share(
            told_apart(r, arm) for r in apart if any(name in RESISTANCES for name, _ in hidden(r))
        ),
        "wrong among names at 0.9": grader.share(not one["right"] for r in rows for one in sure(r)),
        "expected calibration error": grader.calibration(entries)[0]["ece"],
        "probability of the true set": grader.plain(true),
        "entropy, nats": grader.plain([-np.sum(x * np.log(np.maximum(x, 1e-300))) for x in p]),
        "core seconds of a diagnosis": grader.quantile([r[arm]["cpu_s"] for r in rows], 0.5),
    }  # fmt: skip


def expected(rows: Sequence[Row]) -> Row:
    """Expected and achieved separation of sets of effects by designed swims."""
    grader = servo_grader()
    out: Row = {
        f"entropy {when} the swim, nats": grader.plain(
            [r["stated"][f"entropy_{when}_nats"] for r in rows]
        )
        for when in ("before", "after")
    }
    for low, high in ((0.5, 0.7), (0.7, 0.9), (0.9, 1.001)):
        out[f"the true set favoured, pairs with it expected with {low:g} to {high:g}"] = (
            grader.share(
                set(told["favoured"]) == set(r["effects"])
                for r in rows
                for told in r["designed"]["told"]
                if set(r["effects"]) in (set(told["first"]), set(told["second"]))
                and low <= told["expected"] < high
            )
        )
    seconds = [r["design_cpu_s"] for r in rows]
    return out | {"core seconds of a design": grader.quantile(seconds, 0.5)}


def report(benches: Sequence[Bench], out: Path, seed: int) -> None:
    """Write the measures of all arms, and every case; print the measures."""
    rows, shown = rows_of(benches), servo_grader().shown
    arms = {arm: measures(rows, arm) for arm in SWIMS}
    designs = expected(rows)
    kept = [
        {name: row[name] for name in ("case", "kind", "effects", "strength", "evidence")}
        | {arm: {"verdict": row[arm]["verdict"], "named": row[arm]["named"]} for arm in SWIMS}
        for row in rows
    ]
    content = {"seed": seed, "cases": len(rows), "arms": arms, "designs": designs, "rows": kept}
    write_json(out, content)
    print(f"{len(rows)} cases")
    for name in arms["first"]:
        print(f"{name:52s} " + "  ".join(shown(arms[arm][name]) for arm in SWIMS))
    for name, metric in designs.items():
        print(f"{name}: {shown(metric)}")
