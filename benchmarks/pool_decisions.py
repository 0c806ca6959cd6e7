"""Read the thresholds and the odds that decide a diagnosis of swims off development sets.

    python -m benchmarks.pool_decisions SET VERDICTS RESULTS [SET ...] [--in-water] [--go-on]

Takes the searches of ``datasets/pool/sealed_solve.py``, fits the curves of odds, and looks for the
thresholds whose answers are best; prints what they are worth with whole robots left out. The others
stay as they are. What a model has to bring on the end of its swim to be offered is
read off the other swims of the cases, as ``sealed_grade.py`` says what each set foretells of them,
where RESULTS are there. ``--go-on``: what is there is from other cases; the curves become those of
both, thresholds stay. Writes ``decisions`` of ``sim/inference/law_error.json``, or of
``law_error_in_water.json``. What is chosen keeps its value and its reason.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decision_curves import logistic, loss
from sim.inference.law_error import FILE, IN_WATER, named_decisions
from sim.inference.swim_decision import BANDS, ROWS, Decided, Terms, decide
from sim2real.output import write_json

Numbers = dict[str, float]

LEVELS = {
    "alike": (1.0, 2.5, 4.0, 6.0), "alike_imitated": (2.5, 5.0, 8.0, 12.0, 20.0),
    "flagged from": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
}  # fmt: skip
"""Where thresholds are looked for: evidence within which others do as well, and the probability
that anything is there from which a swim counts as flagged."""
_WIDE = 0.1
"""What each further name in the first group of a single effect costs."""
DETECTABLE = 10.0
"""Log-likelihood ratio of one who knows the water from which something can be seen."""
_AT_ONCE = 3
_SPREADS, _COVERED = np.arange(0.0, 0.41, 0.01), 0.88
_GAINS, _BETTER, _SURE = (-4.0, -2.0, 0.0, 2.0), np.arange(0.0, 0.21, 0.03), (0.8, 0.9, 0.95, 1.0)
_WORSE, _RARELY = 0.01, 0.02
"""Share by which an error may grow, and share of cases in which it may grow by more."""
_PRIOR, _GOES_ON = 1.0, 0.5
"""Spread of the weights over the size of what they weigh: about 0, and about earlier ones."""
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
            "further",
        )
    }
    stated: list[tuple[float, bool]] = []
    for truth, said in cases:
        hidden = _hidden(truth)
        right = [matches(one.group, hidden) for one in said.named]
        stated += [
            (one.probability, ok)
            for one, ok in zip(said.named, right, strict=True)
            if one.probability >= 0.05
        ]
        sure = [ok for one, ok in zip(said.named, right, strict=True) if one.probability >= 0.9]
        counts["wrong"] += [float(not ok) for ok in sure]
        likely = [one for one in said.named if one.probability >= 0.5]
        flagged = said.verdict != "consistent"
        seen = truth["oracle"]["llr_total"] >= DETECTABLE
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
            counts["further"].append(len(said.named[0].group) - 1.0 if said.named else 0.0)
        if truth["kind"] == "double" and seen:
            met = sum(any(matches(one.group, [h]) for one in likely) for h in hidden)
            counts["both"].append(float(met == 2 and len(likely) == 2))
    out = {name: float(np.mean(v)) if v else 0.0 for name, v in counts.items()}
    p, ok = np.array([x for x, _ in stated]), np.array([float(y) for _, y in stated])
    place = np.minimum((10 * p).astype(int), 9)
    out["ece"] = float(
        sum(abs(p[place == k].sum() - ok[place == k].sum()) for k in range(10)) / max(len(p), 1)
    )
    out["loss"] = loss(p, ok)
    return out


def _hidden(truth: dict[str, Any]) -> list[tuple[str, str]]:
    outside = truth["kind"] == "outside"
    return [] if outside else [(e["effect"], e["component"]) for e in truth["effects"]]


def matches(group: Any, hidden: list[tuple[str, str]]) -> bool:  # noqa: ANN401
    """Whether a group of effects has one of those concealed; alone, of the right component."""
    alone = len({name for name, _ in group}) == 1
    return any(
        (name == effect and (not alone or of == where))
        for name, of in group
        for effect, where in hidden
    )


def worth(found: dict[str, float]) -> float:
    """What measures are worth: those of the issue, false names dearest.

    Up to 15 % of nulls may be flagged at no cost: a flag is no name.
    """
    over = lambda name, bar: max(0.0, found[name] - bar)  # noqa: E731
    return (
        found["detection"] + found["group_first"] + 0.8 * found["both"] + found["abstains"]
        - 6 * over("false_alarm", 0.0) - 4 * over("wrong", 0.015) - 3 * over("ece", 0.05)
        - max(0.0, found["flagged_null"] - 0.15) - _WIDE * found["further"]
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
        **{
            f"usual misfit {row} {band}": float(misfit[k, b])
            for k, row in enumerate(ROWS)
            for b, band in enumerate(BANDS)
        },
    }


def read_cases(sets: Sequence[Path], verdicts: Sequence[Path], graded: Sequence[Path]) -> Cases:
    """Answers and searches of the cases of sets."""
    cases = []
    for challenge, place, results in zip(sets, verdicts, graded, strict=True):
        rows = json.loads(results.read_text())["cases"] if results.exists() else []
        foretold = {row["case"]: row["heldout"] for row in rows}
        for one in json.loads((challenge / "answers.json").read_text())["cases"]:
            path = place / one["case"] / "raw.json"
            if path.exists():
                truth = one | {"robot": f"{challenge.name} {one['robot']}"}
                truth["foretold"] = foretold.get(one["case"])
                found = json.loads(path.read_text()) | {"referred": one["references"]}
                cases.append((truth, found))
    return cases


def choose(
    cases: Cases, target: Path, at_once: int = _AT_ONCE, *, go_on: bool = False,
    relative: float | None = None,
) -> None:  # fmt: skip
    """Write the numbers whose answers to development cases are best; print what they are worth.

    Args:
        cases: Answers and searches.
        target: The file whose ``decisions`` are replaced.
        at_once: Number of processes.
        go_on: Whether to start from the numbers that are there, and change only the curves.
        relative: The new relative error of estimates, see ``spread_of``; None to keep it.
    """
    content = json.loads(target.read_text())
    content["decisions"] = named_decisions(content["decisions"])
    robots = sorted({truth["robot"] for truth, _ in cases})
    parts = [[c for c in cases if c[0]["robot"] != out] for out in robots]
    tune = partial(tuned, begun=content["decisions"], go_on=go_on)
    with ProcessPoolExecutor(at_once) as pool:
        *found, best = pool.map(tune, [*parts, cases])
    best |= offering([c for c in cases if c[0]["foretold"]], best, go_on=go_on)
    apart = [
        (t, decide(f, numbers))
        for numbers, out in zip(found, robots, strict=True)
        for t, f in cases
        if t["robot"] == out
    ]
    print(len(cases), "cases of", len(robots), "robots; robots left out:", judged(apart))
    if relative is not None:
        best["relative"] = relative
    content["decisions"] = {k: float(f"{v:.4g}") for k, v in best.items()}
    earlier = f", after {content['decided']}" if go_on else ""
    content["decided"] = f"{len(cases)} cases of {len(robots)} robots{earlier}"
    write_json(target, content)
    print("all:", judged([(t, decide(f, best)) for t, f in cases]))


def offering(cases: Cases, numbers: Numbers, *, go_on: bool = False) -> Numbers:
    """What a set has to bring on the end of a swim, so that hardly one foretells another worse.

    ``go_on``: only how certain an effect must be that need not better the speed is looked for.
    """
    kept = (numbers["held_gain"],), (numbers["held_better"],)
    gains, better = kept if go_on else (_GAINS, _BETTER)
    best: Numbers = {}
    top = -np.inf
    for levels in product(gains, better, _SURE) if cases else ():
        given = dict(
            zip(("held_gain", "held_better", "held_sure"), map(float, levels), strict=True)
        )
        said = [(truth, decide(found, numbers | given)) for truth, found in cases]
        lower = np.array([_lower(truth, one) for truth, one in said])
        if np.mean(lower < -_WORSE) <= _RARELY and lower.mean() > top:
            top, best = lower.mean(), given
    return best


def _lower(truth: dict[str, Any], said: Decided) -> float:
    """Logarithm of the other swim's error without a model over that with it."""
    for one in truth["foretold"]["tried"]:
        if frozenset((str(a), str(b)) for a, b in one["names"]) == said.offered:
            return float(np.log(truth["foretold"]["base"] / one["error"]))
    return 0.0


def spread_of(sets: Sequence[Path], verdicts: Sequence[Path], known: float) -> float:
    """What estimates are off by beyond their own sd, of their size: then 90 % hold the truth.

    Of effects that were named exactly; ``known``: the spread that the verdicts' intervals have.
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
    sd = np.sqrt(np.maximum(sd**2 - (known * size) ** 2, 0.0))
    for relative in _SPREADS:
        if np.mean(np.abs(off) <= 1.645 * np.hypot(sd, relative * size)) >= _COVERED:
            break
    return float(relative)


def tuned(cases: Cases, begun: Numbers, *, go_on: bool = False) -> Numbers:
    """Numbers that decide best: curves of odds, what is alike, and from where a swim is flagged.

    The others stay as they begin: searched at random, they answered robots left out worse.
    ``go_on``: only the curves are new, not far from what they begin with.
    """
    if go_on:
        return curves(cases, begun, begun)
    best = curves(cases, begun | usually(cases))
    for name, levels in LEVELS.items():
        trials = [curves(cases, best | {name: level}) for level in levels]
        best = max(trials, key=lambda one: worth(judged([(t, decide(f, one)) for t, f in cases])))
    return best


def curves(cases: Cases, numbers: Numbers, about: Numbers | None = None) -> Numbers:
    """Weights of the logistic curves: of something that the catalogue lacks, anything, and names.

    What nobody could see is no example of anything that is there. ``about``: earlier weights; those
    of the first two curves stay where no case has something outside the catalogue.
    """
    weights = partial(_weights, about=about)
    scale = numbers["evidence_scale"]
    curve_names = ("name: ", "unlisted: ", "anything: ")
    flat = {name: 0.0 for name in numbers if name.startswith(curve_names)}
    out = numbers | flat
    said = [(truth, decide(found, out)) for truth, found in cases]
    outside = [truth["kind"] == "outside" for truth, _ in said]
    if about and not any(outside):
        out |= {k: v for k, v in about.items() if not k.startswith("name: ")}
    else:
        out |= weights("unlisted", [one.features.terms(scale) for _, one in said], outside)
        clear = [
            (truth["kind"] != "null", one.features.terms(scale))
            for truth, one in said
            if truth["kind"] == "null" or truth["oracle"]["llr_total"] >= DETECTABLE
        ]
        out |= weights("anything", [terms for _, terms in clear], [there for there, _ in clear])
    said = [(truth, decide(found, out)) for truth, found in cases]
    names = [(truth, one) for truth, each in said for one in each.named]
    right = [matches(one.group, _hidden(truth)) for truth, one in names]
    return out | weights("name", [one.features.terms() for _, one in names], right)


def _weights(
    curve: str, terms: Sequence[Terms], right: Sequence[bool], about: Numbers | None
) -> Numbers:
    """Of a curve, as decisions hold them."""
    names = list(terms[0])
    x = np.array([[one[name] for name in names] for one in terms])
    y = np.array(right, dtype=np.float64)
    earlier = np.array([about[f"{curve}: {name}"] for name in names]) if about else None
    found = logistic(x, y, _GOES_ON if about else _PRIOR, earlier)
    return {f"{curve}: {name}": float(v) for name, v in zip(names, found, strict=True)}


def main() -> None:
    """Choose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", type=Path, nargs="+", help="sets, verdicts and results in turns")
    parser.add_argument("--in-water", action="store_true")
    parser.add_argument("--go-on", action="store_true", help="from the odds of earlier cases")
    parser.add_argument("--processes", type=int, default=_AT_ONCE)
    options = parser.parse_args()
    sets, verdicts, graded = (options.sets[k::3] for k in range(3))
    target = IN_WATER if options.in_water else FILE
    relative = None
    if not options.go_on:
        known = named_decisions(json.loads(target.read_text())["decisions"])["relative"]
        relative = spread_of(sets, verdicts, known)
    cases = read_cases(sets, verdicts, graded)
    choose(cases, target, options.processes, go_on=options.go_on, relative=relative)


if __name__ == "__main__":
    main()
