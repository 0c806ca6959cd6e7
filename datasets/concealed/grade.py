"""Compare what was said of a set with what is true of it.

python datasets/concealed/grade.py SET VERDICTS --out RESULTS.json

SET is what ``make.py`` wrote, VERDICTS what ``solve.py`` wrote. Every measure is defined here,
before any run; every case is listed in the results, failures and all.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta
from tqdm import tqdm

from sim2real.model import read_model
from sim2real.recording import read_recording
from sim2real.servo.predict import predict

Json = dict[str, Any]

CONFIDENT, NAMED, DETECTABLE = 0.9, 0.5, 10.0
BINS = 10
_NULLS = ("null", "trap")
_EVERYWHERE = ("supply", "link")


@dataclass(frozen=True)
class Entry:
    """One case: its name, what is true of it and what was said, and its held-out errors."""

    case: str
    answer: Json
    said: Json
    heldout: dict[str, tuple[float, float, float]]

    @property
    def kind(self) -> str:
        """``null``, ``single``, ``double`` or ``outside``; a trap is a null."""
        return "null" if self.answer["kind"] in _NULLS else str(self.answer["kind"])

    @property
    def flagged(self) -> bool:
        """Whether a mismatch was seen at all."""
        return bool(self.said["verdict"] != "consistent")

    @property
    def llr(self) -> float:
        """The oracle's log-likelihood ratio."""
        return float(self.answer["oracle"].get("llr_total") or 0.0)

    @property
    def effects(self) -> list[Json]:
        """What was named, likeliest first."""
        return sorted(self.said["effects"], key=lambda e: -e["probability"])

    def true_group(self, entry: Json) -> bool:
        """Whether a named group has one of the true effects, at its place."""
        return any(t["effect"] in entry["group"] and _placed(entry, t) for t in self.hidden)

    @property
    def hidden(self) -> list[Json]:
        """Effects of the catalogue that are there."""
        return [] if self.kind == "outside" else list(self.answer["effects"])


def main() -> None:
    """Grade a set and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    entries = list(read(options.set, options.verdicts))
    options.out.write_text(json.dumps(grade(entries), indent=1) + "\n")
    for name, measure in grade(entries)["measures"].items():
        print(f"{name:45} {measure}")


def read(folder: Path, verdicts: Path) -> Iterator[Entry]:
    """Every case of a set that was answered."""
    answers = json.loads((folder / "answers.json").read_text())
    for answer in tqdm(answers, desc="grade", disable=None):
        said = verdicts / answer["case"] / "diagnosis.json"
        if said.exists():
            errors = _heldout(folder, said.parent, answer)
            yield Entry(answer["case"], answer, json.loads(said.read_text()), errors)


def grade(entries: Sequence[Entry]) -> Json:
    """All measures, and what each case contributed."""
    nulls = [e for e in entries if e.kind == "null"]
    outside = [e for e in entries if e.kind == "outside"]
    hidden = [e for e in entries if e.kind in ("single", "double")]
    seen = [e for e in hidden if e.llr >= DETECTABLE]
    singles = [e for e in seen if e.kind == "single"]
    doubles = [e for e in seen if e.kind == "double"]
    claims = [(e, c) for e in entries for c in e.effects if c["probability"] >= CONFIDENT]
    measures = {
        "false_alarms": _share(nulls, lambda e: _best(e) >= CONFIDENT),
        "nulls_flagged": _share(nulls, lambda e: e.flagged),
        "detectable_flagged": _share(seen, lambda e: e.flagged),
        "first_group_right": _share(singles, _first_group),
        "first_name_right": _share(singles, _first_name),
        "first_name_in_oracle_group": _share(
            [e for e in singles if e.answer["oracle"].get("group")], _in_oracle_group
        ),
        "component_right": _share([e for e in singles if e.flagged], _component_right),
        "confident_and_wrong": _share(claims, lambda pair: not pair[0].true_group(pair[1])),
        "calibration": _calibration(entries),
        "outside_abstains": _share(outside, _abstains),
        "outside_confident_names": _share(outside, lambda e: _best(e) >= CONFIDENT),
        "windows_iou": _windows([e for e in outside if any(e.answer["windows_s"].values())]),
        "recoverable_removed": _removed(singles),
        "null_harm": _harm(nulls),
        "both_named": _share(doubles, _both),
        "group_size": float(np.mean([len(x["group"]) for e in entries for x in e.effects] or [0])),
        "parameter_error": _parameter_error(singles),
    }
    return {
        "measures": measures,
        "counts": dict(Counter(e.kind for e in entries)),
        "detectable": {"single": len(singles), "double": len(doubles)},
        "by_effect": _by_effect(singles),
        "confusion": _confusion(singles),
        "by_outside_kind": _by_outside_kind(outside),
        "power": _power(hidden),
        "cases": [_row(e) for e in entries],
    }


def _placed(entry: Json, truth: Json) -> bool:
    return entry["component"] == truth["component"] or truth["component"] in _EVERYWHERE


def _best(entry: Entry) -> float:
    return max((e["probability"] for e in entry.said["effects"]), default=0.0)


def _first_group(entry: Entry) -> bool:
    return bool(entry.effects) and entry.true_group(entry.effects[0])


def _first_name(entry: Entry) -> bool:
    return _first_group(entry) and entry.effects[0]["effect"] == entry.hidden[0]["effect"]


def _in_oracle_group(entry: Entry) -> bool:
    group = entry.answer["oracle"]["group"]
    return bool(entry.effects) and entry.effects[0]["effect"] in group


def _component_right(entry: Entry) -> bool:
    said = entry.effects or entry.said["mismatch"]
    return bool(said) and _placed(said[0], entry.answer["effects"][0])


def _abstains(entry: Entry) -> bool:
    return entry.flagged and not any(e["probability"] >= NAMED for e in entry.effects)


def _both(entry: Entry) -> bool:
    named = [e for e in entry.effects if e["probability"] >= NAMED]
    return all(
        any(t["effect"] in e["group"] and _placed(e, t) for e in named) for t in entry.hidden
    )


def _share(things: Sequence[Any], holds: Callable[[Any], bool]) -> Json:
    """A share with its 95 % interval (Clopper, Pearson, Biometrika 26 (1934) 404-413)."""
    n, k = len(things), sum(bool(holds(thing)) for thing in things)
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return {"share": k / n if n else None, "of": n, "count": k, "interval": [low, high]}


def _calibration(entries: Sequence[Entry]) -> Json:
    """Expected calibration error over equal bins of stated probability."""
    pairs = [(x["probability"], e.true_group(x)) for e in entries for x in e.effects]
    for e in entries:
        taken = {(x["effect"], x["component"]) for x in e.effects}
        for rival in e.said["rivals"]:
            if (rival["effect"], rival["component"]) not in taken and rival["probability"] >= 0.05:
                pairs.append(
                    (rival["probability"], e.true_group(rival | {"group": [rival["effect"]]}))
                )
    p, right = np.array([x[0] for x in pairs]), np.array([x[1] for x in pairs], dtype=float)
    place = np.minimum((p * BINS).astype(int), BINS - 1)
    table = [
        {
            "stated": float(p[place == b].mean()),
            "right": float(right[place == b].mean()),
            "n": int(np.sum(place == b)),
        }
        for b in range(BINS)
        if np.any(place == b)
    ]
    error = sum(row["n"] * abs(row["stated"] - row["right"]) for row in table) / max(p.size, 1)
    return {"ece": float(error), "brier": float(np.mean((p - right) ** 2)), "table": table}


def _windows(entries: Sequence[Entry]) -> Json:
    overlaps = []
    for entry in entries:
        joint = entry.answer["effects"][0]["component"]
        said: dict[str, list[list[float]]] = {}
        for mismatch in entry.said["mismatch"]:
            if mismatch["component"] == joint:
                said = mismatch["windows_by_recording"]
        for recording in ("a", "b"):
            true = entry.answer["windows_s"].get(recording) or []
            if true:
                overlaps.append(_overlap(true, said.get(recording) or []))
    return {"median": float(np.median(overlaps)) if overlaps else None, "of": len(overlaps)}


def _overlap(true: Sequence[Sequence[float]], said: Sequence[Sequence[float]]) -> float:
    """Intersection over union of two sets of stretches."""
    grid = np.arange(0.0, 40.0, 0.01)
    masks = [
        np.any([(grid >= a) & (grid <= b) for a, b in some] or [np.zeros(grid.size, bool)], axis=0)
        for some in (true, said)
    ]
    return float((masks[0] & masks[1]).sum() / max((masks[0] | masks[1]).sum(), 1))


def _heldout(folder: Path, verdict: Path, answer: Json) -> dict[str, tuple[float, float, float]]:
    """Errors on the recording that only the grader has: baseline, enriched, floor; rad by joint."""
    recording = read_recording(folder / "heldout" / answer["case"] / "c.csv")
    models = [read_model(verdict / name) for name in ("baseline.json", "enriched.json")]
    floors = answer["oracle"].get("heldout_floor_rad", {})
    errors = {}
    for j, joint in enumerate(recording.joints):
        if not all(joint in model.joints for model in models):
            continue
        command = {joint: recording.command[:, j]}
        seen = np.isfinite(recording.position[:, j])
        rms = [
            float(
                np.sqrt(
                    np.mean(
                        (
                            predict(m, recording.t, command, recording.loads)[joint]
                            - recording.position[:, j]
                        )[seen]
                        ** 2
                    )
                )
            )
            for m in models
        ]
        errors[joint] = (rms[0], rms[1], float(floors.get(joint, 0.0)))
    return errors


def _removed(entries: Sequence[Entry]) -> Json:
    """Share of the error above the noise that the enriched model removes, where there is one."""
    shares = []
    for entry in entries:
        truth = entry.answer["effects"][0]
        joints = (
            [truth["component"]] if truth["component"] in entry.heldout else list(entry.heldout)
        )
        plain, rich, floor = (
            float(np.sqrt(np.mean([entry.heldout[j][k] ** 2 for j in joints]))) for k in range(3)
        )
        if plain > 1.05 * floor:
            shares.append((plain - rich) / (plain - floor))
    if not shares:
        return {"median": None, "p10": None, "of": 0}
    return {
        "median": float(np.median(shares)),
        "p10": float(np.quantile(shares, 0.1)),
        "of": len(shares),
    }


def _harm(entries: Sequence[Entry]) -> Json:
    changes = [rich / plain - 1 for e in entries for plain, rich, _ in e.heldout.values()]
    return {
        "mean_change": float(np.mean(changes)) if changes else None,
        "worse_by_1_percent": float(np.mean(np.array(changes) > 0.01)) if changes else None,
        "of": len(changes),
    }


def _parameter_error(entries: Sequence[Entry]) -> Json:
    errors = []
    for entry in filter(_first_name, entries):
        truth, said = entry.answer["effects"][0]["parameters"], entry.effects[0]["parameters"]
        name = next(iter(truth))
        if name in said and truth[name]:
            errors.append(abs(said[name]["mean"] / truth[name] - 1))
    return {"median": float(np.median(errors)) if errors else None, "of": len(errors)}


def _by_effect(entries: Sequence[Entry]) -> Json:
    table: Json = {}
    for entry in entries:
        row = table.setdefault(
            entry.hidden[0]["effect"], {"cases": 0, "flagged": 0, "group": 0, "name": 0}
        )
        row["cases"] += 1
        row["flagged"] += entry.flagged
        row["group"] += _first_group(entry)
        row["name"] += _first_name(entry)
    return table


def _confusion(entries: Sequence[Entry]) -> Json:
    table: dict[str, Counter[str]] = {}
    for entry in entries:
        said = (
            entry.effects[0]["effect"]
            if entry.effects
            else ("unnamed" if entry.flagged else "consistent")
        )
        table.setdefault(entry.hidden[0]["effect"], Counter())[said] += 1
    return {effect: dict(row) for effect, row in table.items()}


def _by_outside_kind(entries: Sequence[Entry]) -> Json:
    table: Json = {}
    for entry in entries:
        row = table.setdefault(
            entry.answer["effects"][0]["effect"], {"cases": 0, "flagged": 0, "abstains": 0}
        )
        row["cases"] += 1
        row["flagged"] += entry.flagged
        row["abstains"] += _abstains(entry)
    return table


def _power(entries: Sequence[Entry]) -> list[Json]:
    """Share flagged and named right, by the oracle's log-likelihood ratio."""
    edges = [-np.inf, 3, 10, 30, 100, 300, 1000, 10000, np.inf]
    table = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        some = [e for e in entries if e.kind == "single" and low <= e.llr < high]
        if some:
            table.append(
                {
                    "from": low if np.isfinite(low) else None,
                    "cases": len(some),
                    "flagged": float(np.mean([e.flagged for e in some])),
                    "group": float(np.mean([_first_group(e) for e in some])),
                }
            )
    return table


def _row(entry: Entry) -> Json:
    return {
        "case": entry.case,
        "kind": entry.answer["kind"],
        "truth": [f"{e['effect']}@{e['component']}" for e in entry.answer["effects"]],
        "llr": round(entry.llr, 1),
        "verdict": entry.said["verdict"],
        "said": [
            f"{'|'.join(e['group'])}@{e['component']} {e['probability']:.2f}" for e in entry.effects
        ],
        "heldout_mrad": {
            j: [round(1e3 * x, 3) for x in errors] for j, errors in entry.heldout.items()
        },
    }


if __name__ == "__main__":
    main()
