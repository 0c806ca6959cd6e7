"""Fit the thresholds and the odds of a diagnosis of swims to development sets.

    python -m benchmarks.pool_decisions SET VERDICTS RESULTS [SET ...] [--in-water] [--go-on]

Fits the logistic curves to searches of ``datasets/pool/sealed_solve.py`` and looks for the
thresholds with the best answers; prints the measures with whole robots left out. The improvement on
the end of its swim from which a model is offered is fitted to the held-out swims of the cases, if
RESULTS of ``datasets/sealed/grade.py`` exist. ``--go-on``: the present weights are from other
cases; the curves are fitted to both, and thresholds keep their values. Writes ``decisions`` of
``sim/inference/law_error.json``, or of ``law_error_in_water.json``. Thresholds that were chosen
keep their values and reasons.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decision_curves import logistic, loss
from benchmarks.harness import command_line, spread
from sim.inference.law_error import FILE, IN_WATER
from sim.inference.signal_error import BANDS, ROWS
from sim.inference.swim_decision import Decided, Terms, decide
from sim2real.output import write_json

Numbers = dict[str, float]

LEVELS = {
    "alike": (1.0, 2.5, 4.0, 6.0), "alike_imitated": (2.5, 5.0, 8.0, 12.0, 20.0),
}  # fmt: skip
"""Values of the thresholds that are tried: evidence within which other effects do as well."""
FLAGGED, QUIET = "flagged from", 0.9
"""Probability of any effect from which a swim is flagged; share of nulls that must not be."""
_WIDE = 0.1
"""Cost of each further name in the first group of a single effect."""
DETECTABLE = 10.0
"""Log-likelihood ratio of the oracle from which an effect is detectable."""
_AT_ONCE = 3
_SPREADS, _COVERED = np.arange(0.0, 0.41, 0.01), 0.88
_GAINS, _BETTER, _SURE = (-4.0, -2.0, 0.0, 2.0), np.arange(0.0, 0.21, 0.03), (0.8, 0.9, 0.95, 1.0)
_WORSE, _RARELY = 0.01, 0.02
"""Share by which a held-out error may grow, and share of cases in which it may grow by more."""
_PRIOR, _GOES_ON = 1.0, 0.5
"""Prior standard deviation of the weights of normalised terms: about 0, and about earlier ones."""
_USUAL = 0.85
"""Share of the cases of the catalogue with a residual that counts as usual."""
Cases = list[tuple[dict[str, Any], dict[str, Any]]]


def measures(cases: list[tuple[dict[str, Any], Decided]]) -> dict[str, float]:
    """The grader's measures of (answer, decision) pairs."""
    names = "false_alarm", "flagged_null", "detection", "group_first", "both"
    counts: dict[str, list[float]] = {k: [] for k in (*names, "abstains", "wrong", "further")}
    stated: list[tuple[float, bool]] = []
    for truth, decision in cases:
        hidden = _hidden(truth)
        right = [matches(one.group, hidden) for one in decision.named]
        stated += [
            (one.probability, ok)
            for one, ok in zip(decision.named, right, strict=True)
            if one.probability >= 0.05
        ]
        sure = [ok for one, ok in zip(decision.named, right, strict=True) if one.probability >= 0.9]
        counts["wrong"] += [float(not ok) for ok in sure]
        likely = [one for one in decision.named if one.probability >= 0.5]
        flagged = decision.verdict != "consistent"
        detectable = truth["oracle"]["llr_total"] >= DETECTABLE
        if truth["kind"] == "null":
            counts["false_alarm"].append(float(bool(sure)))
            counts["flagged_null"].append(float(flagged))
        if truth["kind"] == "outside":
            good = decision.verdict in ("unexplained", "partly_explained") and not likely
            counts["abstains"].append(float(good))
        if truth["kind"] in ("single", "double") and detectable:
            counts["detection"].append(float(flagged))
        if truth["kind"] == "single" and detectable:
            counts["group_first"].append(float(bool(right) and right[0]))
            counts["further"].append(len(decision.named[0].group) - 1.0 if decision.named else 0.0)
        if truth["kind"] == "double" and detectable:
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
    """Whether a group contains a concealed effect; a group of one name needs its component too."""
    alone = len({name for name, _ in group}) == 1
    return any(
        (name == effect and (not alone or of == where))
        for name, of in group
        for effect, where in hidden
    )


def worth(found: dict[str, float]) -> float:
    """Value of the measures, with the largest cost for false names."""
    over = lambda name, bar: max(0.0, found[name] - bar)  # noqa: E731
    return (
        found["detection"] + found["group_first"] + 0.8 * found["both"] + found["abstains"]
        - 6 * over("false_alarm", 0.0) - 4 * over("wrong", 0.015) - 3 * over("ece", 0.05)
        - _WIDE * found["further"]
    )  # fmt: skip


def usually(cases: Cases) -> Numbers:
    """Usual residuals, and gains by unnamed shapes, of cases whose effects the catalogue has."""
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
        held_out = {row["case"]: row["heldout"] for row in rows}
        for one in json.loads((challenge / "answers.json").read_text())["cases"]:
            path = place / one["case"] / "raw.json"
            if path.exists():
                truth = one | {"robot": f"{challenge.name} {one['robot']}"}
                truth["held_out"] = held_out.get(one["case"])
                found = json.loads(path.read_text()) | {"referred": one["references"]}
                cases.append((truth, found))
    return cases


def choose(
    cases: Cases, target: Path, at_once: int = _AT_ONCE, *, go_on: bool = False,
    relative: float | None = None,
) -> None:  # fmt: skip
    """Write the numbers with the best answers to development cases; print their measures.

    Args:
        cases: Answers and searches.
        target: The file whose ``decisions`` are replaced.
        at_once: Number of processes.
        go_on: Whether to start from the present numbers and change only the curves.
        relative: The new relative error of estimates, see ``spread_of``; None to keep it.
    """
    content = json.loads(target.read_text())
    robots = sorted({truth["robot"] for truth, _ in cases})
    parts = [[c for c in cases if c[0]["robot"] != out] for out in robots]
    tune = partial(tuned, begun=content["decisions"], go_on=go_on)
    *found, best = spread(tune, [*parts, cases], at_once, unit="choice")
    left_out = dict(zip(robots, found, strict=True))
    if not go_on:
        best[FLAGGED] = flagged_from(cases, left_out)
    best |= offering([c for c in cases if c[0]["held_out"]], best, go_on=go_on)
    apart = decided_apart(cases, left_out, best[FLAGGED])
    print(len(cases), "cases of", len(robots), "robots; robots left out:", measures(apart))
    if relative is not None:
        best["relative"] = relative
    content["decisions"] = {k: float(f"{v:.4g}") for k, v in best.items()}
    earlier = f", after {content['decided']}" if go_on else ""
    content["decided"] = f"{len(cases)} cases of {len(robots)} robots{earlier}"
    write_json(target, content)
    print("all:", measures([(t, decide(f, best)) for t, f in cases]))


def decided_apart(
    cases: Cases, left_out: Mapping[str, Numbers], flagged: float
) -> list[tuple[dict[str, Any], Decided]]:
    """Answers and decisions, by the numbers that each robot's cases had no part in."""
    return [
        (truth, decide(found, {**left_out[truth["robot"]], FLAGGED: flagged}))
        for truth, found in cases
    ]


def flagged_from(cases: Cases, left_out: Mapping[str, Numbers]) -> float:
    """The lowest threshold of a flag with which the nulls of robots left out are quiet enough."""
    nulls = [(truth, found) for truth, found in cases if truth["kind"] == "null"]
    for level in np.arange(0.3, 1.0, 0.02).tolist():
        apart = decided_apart(nulls, left_out, level)
        if np.mean([one.verdict == "consistent" for _, one in apart]) >= QUIET:
            break
    return float(level)


def offering(cases: Cases, numbers: Numbers, *, go_on: bool = False) -> Numbers:
    """Improvement on the end of a swim with which models hardly ever increase held-out errors.

    ``go_on``: fits only the probability from which an effect need not improve the speed.
    """
    kept = (numbers["held_gain"],), (numbers["held_better"],)
    gains, better = kept if go_on else (_GAINS, _BETTER)
    best: Numbers = {}
    top = -np.inf
    for levels in product(gains, better, _SURE) if cases else ():
        given = dict(
            zip(("held_gain", "held_better", "held_sure"), map(float, levels), strict=True)
        )
        decisions = [(truth, decide(found, numbers | given)) for truth, found in cases]
        lower = np.array([_lower(truth, one) for truth, one in decisions])
        if np.mean(lower < -_WORSE) <= _RARELY and lower.mean() > top:
            top, best = lower.mean(), given
    return best


def _lower(truth: dict[str, Any], decision: Decided) -> float:
    """Logarithm of the held-out error without a model over that with it."""
    for one in truth["held_out"]["tried"]:
        if frozenset((str(a), str(b)) for a, b in one["names"]) == decision.offered:
            return float(np.log(truth["held_out"]["base"] / one["error"]))
    return 0.0


def spread_of(sets: Sequence[Path], verdicts: Sequence[Path], known: float) -> float:
    """Relative standard deviation that 90 % intervals of the estimates need in addition.

    Of effects that were named exactly; ``known`` is the one that the verdicts' intervals include.
    """
    rows = []
    for challenge, place in zip(sets, verdicts, strict=True):
        for one in json.loads((challenge / "answers.json").read_text())["cases"]:
            path = place / one["case"] / "diagnosis.json"
            hidden = {(e["effect"], e["component"]): e["parameters"] for e in one["effects"]}
            for effect in json.loads(path.read_text())["effects"] if path.exists() else ():
                for name, true in hidden.get((effect["effect"], effect["component"]), {}).items():
                    estimate = effect["parameters"].get(name)
                    if estimate:
                        rows.append((true - estimate["mean"], estimate["sd"], estimate["mean"]))
    off, sd, size = np.array(rows).T
    sd = np.sqrt(np.maximum(sd**2 - (known * size) ** 2, 0.0))
    for relative in _SPREADS:
        if np.mean(np.abs(off) <= 1.645 * np.hypot(sd, relative * size)) >= _COVERED:
            break
    return float(relative)


def tuned(cases: Cases, begun: Numbers, *, go_on: bool = False) -> Numbers:
    """Numbers with the best answers: curves, and evidence of alike effects.

    The others keep their values: a random search of them was worse on robots left out. ``go_on``:
    only the curves are fitted, with a prior about their present weights.
    """
    if go_on:
        return curves(cases, begun, begun)
    best = curves(cases, begun | usually(cases))
    for name, levels in LEVELS.items():
        trials = [curves(cases, best | {name: level}) for level in levels]
        best = max(trials, key=lambda one: worth(measures([(t, decide(f, one)) for t, f in cases])))
    return best


def curves(cases: Cases, numbers: Numbers, about: Numbers | None = None) -> Numbers:
    """Weights of the logistic curves: of an unlisted effect, of any effect, and of names.

    Undetectable effects are no examples of the curve of any effect. ``about``: earlier weights;
    those of the first two curves are kept if no case has an effect outside the catalogue.
    """
    weights = partial(_weights, about=about)
    curve_names = ("name: ", "unlisted: ", "anything: ")
    flat = {name: 0.0 for name in numbers if name.startswith(curve_names)}
    out = numbers | flat
    decisions = [(truth, decide(found, out)) for truth, found in cases]
    outside = [truth["kind"] == "outside" for truth, _ in decisions]
    if about and not any(outside):
        out |= {k: v for k, v in about.items() if not k.startswith("name: ")}
    else:
        out |= weights("unlisted", [one.terms for _, one in decisions], outside)
        clear = [
            (truth["kind"] != "null", one.terms)
            for truth, one in decisions
            if truth["kind"] == "null" or truth["oracle"]["llr_total"] >= DETECTABLE
        ]
        out |= weights("anything", [terms for _, terms in clear], [there for there, _ in clear])
    decisions = [(truth, decide(found, out)) for truth, found in cases]
    names = [(truth, one) for truth, each in decisions for one in each.named]
    right = [matches(one.group, _hidden(truth)) for truth, one in names]
    return out | weights("name", [one.terms for _, one in names], right)


def _weights(
    curve: str, terms: Sequence[Terms], right: Sequence[bool], about: Numbers | None
) -> Numbers:
    """Weights of a curve by their names in ``decisions``."""
    names = list(terms[0])
    x = np.array([[one[name] for name in names] for one in terms])
    y = np.array(right, dtype=np.float64)
    earlier = np.array([about[f"{curve}: {name}"] for name in names]) if about else None
    found = logistic(x, y, _GOES_ON if about else _PRIOR, earlier)
    return {f"{curve}: {name}": float(v) for name, v in zip(names, found, strict=True)}


def main() -> None:
    """Fit and write."""
    go_on = (False, "from the odds of earlier cases")
    parser = command_line(__doc__, in_water=False, go_on=go_on, processes=_AT_ONCE)
    parser.add_argument("sets", type=Path, nargs="+", help="sets, verdicts and results in turns")
    options = parser.parse_args()
    sets, verdicts, graded = (options.sets[k::3] for k in range(3))
    target = IN_WATER if options.in_water else FILE
    relative = None
    if not options.go_on:
        known = json.loads(target.read_text())["decisions"]["relative"]
        relative = spread_of(sets, verdicts, known)
    cases = read_cases(sets, verdicts, graded)
    choose(cases, target, options.processes, go_on=options.go_on, relative=relative)


if __name__ == "__main__":
    main()
