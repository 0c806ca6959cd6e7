"""What moved in the answers of the verbs to a fixed set of cases, against ``yardstick.json``.

    make yardstick                                  # a quarter of an hour on two cores
    python -m benchmarks.yardstick --only swim/ --processes 16
    python -m benchmarks.yardstick --write          # store today's answers

A line for every verdict, set of names of at least 90 %, probability, estimate (in standard
deviations of the stored interval), held-out error and refusal that moved, and whether it came
nearer to the truth; then the share that held, by kind, and processor times. Cases are in
``yardstick_cases.py``; those that need ``../shared`` are skipped where it is absent. Answers of the
same code are kept in ``build/yardstick``, so that an interrupted run goes on.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, command_line, spread
from benchmarks.yardstick_cases import Case, cases
from sim2real import cli, predict
from sim2real.recording import read_commands

STORED = ROOT / "benchmarks" / "yardstick.json"
BUILD = ROOT / "build" / "yardstick"
SURE = 0.9
"""Probability from which an effect counts as named."""
MOVED = {"probability": 0.1, "estimate": 0.3, "error": 0.02}
"""Largest change that is none: absolute, in standard deviations, relative."""
PLAIN = ["--no-plots"]
QUIET = {"identify": PLAIN, "calibrate": PLAIN, "diagnose": ["--no-page"], "import": []}
"""Options that leave out pictures."""
IN_90 = 2 * 1.645
"""Standard deviations in an interval of 90 %."""
UNSTATED = 0.01
"""Standard deviation of an estimate without an interval, relative."""
Answer = dict[str, Any]
"""``verdict``, ``names`` (probabilities), ``estimates`` (value and standard deviation), ``errors``,
``cpu_s``, and ``pace_s``, the time of a fixed calculation beside it."""
Answers = dict[str, dict[str, Any]]
"""By case: the answer of each verb, and the hash of its files as ``INPUTS``."""
INPUTS = "inputs"


@dataclass(frozen=True)
class Move:
    """A change: its kind, a text, and whether it came nearer to the truth, if that is known."""

    kind: str
    text: str
    nearer: bool | None = None

    def __str__(self) -> str:
        return self.text + {None: "", True: " (nearer)", False: " (farther)"}[self.nearer]


def moves(before: Answer, after: Answer, truth: dict[str, Any]) -> Iterator[Move]:
    """What changed between two answers of a verb."""
    old, new = before["verdict"], after["verdict"]
    if old != new:
        known = truth.get("verdict")
        yield Move("verdict", f"verdict {old} -> {new}", closer(old != known, new != known))
    names = [sorted(n for n, p in one["names"].items() if p >= SURE) for one in (before, after)]
    if names[0] != names[1]:
        far = [wrong(one, truth) for one in names] if "names" in truth else [0, 0]
        old, new = (", ".join(one) or "nothing" for one in names)
        yield Move("names", f"names {old} -> {new}", closer(*far))
    for name in before["names"].keys() | after["names"].keys():
        p, q = (one["names"].get(name, 0.0) for one in (before, after))
        if abs(p - q) > MOVED["probability"]:
            yield Move("probability", f"{name} {100 * p:.0f} -> {100 * q:.0f} %")
    for name, (x, sd) in before["estimates"].items():
        if name not in after["estimates"]:
            yield Move("estimate", f"{name} is gone")
            continue
        y, true = after["estimates"][name][0], truth.get("estimates", {}).get(name)
        far = abs(y - x) / (sd or UNSTATED * abs(x) or 1.0)
        if far > MOVED["estimate"]:
            nearer = None if true is None else closer(abs(x - true), abs(y - true))
            yield Move("estimate", f"{name} {x:g} -> {y:g}, {far:.1f} standard deviations", nearer)
    for name, x in before["errors"].items():
        y = after["errors"].get(name, math.inf)
        if abs(y - x) > MOVED["error"] * x:
            yield Move("error", f"{name} {x:g} -> {y:g}, {100 * (y / x - 1):+.0f} %", y < x)


def closer(before: float, after: float) -> bool | None:
    """Whether a distance fell; None if it did not change."""
    return None if before == after else after < before


def wrong(names: list[str], truth: dict[str, Any]) -> int:
    """Names without a true effect and true effects without a name; a name may be a group."""
    groups = [{f"{n.split()[0]} {e}" for e in n.split()[1].split("|")} for n in names]
    true, allowed = set(truth["names"]), set(truth["allowed"])
    false = sum(not group & (true | allowed) for group in groups)
    return false + len(true.difference(*groups))


def report(before: Answers, after: Answers, truths: dict[str, Any]) -> Iterator[str]:
    """Lines: every move, then what held by kind, errors by group and processor times by verb."""
    shared = [(n, v) for n in after for v in after[n] if v in before.get(n, {}) and v != INPUTS]
    found: list[Move] = []
    for name, verb in shared:
        moved = list(moves(before[name][verb], after[name][verb], truths.get(name, {})))
        yield from (f"{name} {verb}: {move}" for move in moved)
        found += moved
    for name in sorted(after):
        if before.get(name, {}).get(INPUTS) != after[name].get(INPUTS):
            yield f"{name}: {'stored for other files' if name in before else 'not stored'}"
    pairs = [(n, v, before[n][v], after[n][v]) for n, v in shared]
    sizes = {"verdict": len(pairs), "names": len(pairs)}
    for kind in ("estimate", "error"):
        sizes[kind] = sum(len(b[f"{kind}s"]) for _, _, b, _ in pairs)
    for kind, size in sizes.items():
        bad = sum(move.kind == kind and not move.nearer for move in found)
        yield f"{kind}: the same or nearer in {size - bad} of {size}"
    ratios: dict[str, list[float]] = {}
    for name, verb, b, a in pairs:
        both = [(x, a["errors"][n]) for n, x in b["errors"].items() if a["errors"].get(n)]
        logs = ratios.setdefault(f"{name.split('/')[0]}, {verb}", [])
        logs += [math.log(y / x) for x, y in both]
    for group, logs in sorted(ratios.items()):
        if logs:
            yield f"held-out errors of {group}: {100 * math.expm1(np.mean(logs)):+.1f} %"
    for verb in sorted({v for _, v in shared}):
        here = [(b, a) for _, v, b, a in pairs if v == verb]
        old, new = (sum(pair[k]["cpu_s"] for pair in here) for k in (0, 1))
        slower = sum(a["pace_s"] for _, a in here) / sum(b["pace_s"] for b, _ in here)
        ratio = new / old / slower
        yield f"processor time of {verb}: {old:.0f} -> {new:.0f} s, {ratio:.2f} at equal pace"


def answer_all(job: tuple[Case, Path]) -> None:
    """Write the answers of the verbs of a case, whose files are beside."""
    case, file = job
    warmed_up()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(answers(case, file.parent)))


def answers(case: Case, out: Path) -> dict[str, Any]:
    """Answers of the verbs of a case, in files under ``out``."""
    found: dict[str, Any] = {INPUTS: inputs(case)}
    for verb in case.verbs:
        command, file = verb.split()[0], out / f"{verb.split()[-1]}.json"
        file = file.with_suffix(".csv") if command == "import" else file
        call = [command, *map(str, case.recordings), *case.options, *QUIET[command]]
        call += ["--robot", str(case.robot)] if case.robot else []
        call += ["--model", str(out / "identify.json")] if "model" in verb else []
        pace = pace_s()
        message, cpu_s = called([*call, "--out", str(file)])
        pace = (pace + pace_s()) / 2
        answer = {"names": {}, "estimates": {}, "errors": {}, "cpu_s": cpu_s, "pace_s": pace}
        answer["verdict"] = message.replace(f"{out}/", "").replace(f"{ROOT.parent}/", "") or "done"
        if not message and command != "import":
            try:
                answer |= read(file, case, found.get("identify", {}).get("estimates", {}))
            except Exception as error:  # of a verb, or a file of another form
                answer["verdict"] = f"{type(error).__name__}: {error}"
        found[verb] = rounded(answer)
    return found


def called(arguments: list[str]) -> tuple[str, float]:
    """Run a command; the line of its error, or nothing, and its processor time."""
    said, start = io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            status = cli.main(arguments)
            message = said.getvalue().strip().splitlines()[-1] if status else ""
        except Exception as error:  # a fault of a verb is an answer, too
            message = f"{type(error).__name__}: {error}"
    return message, time.process_time() - start


def read(file: Path, case: Case, plain: dict[str, Any]) -> Answer:
    """The answer in a file; ``plain`` has the deviations of gains without an interval."""
    content = model = json.loads(file.read_text())
    fit, effects = content["fit"], []
    if "verdict" in content:
        effects = content["effects"]
        file, fit = file.with_name(content["model"]), fit["enriched"]
        model = json.loads(file.read_text())
    estimates = dict(stated(model, plain))
    names = {}
    for e in effects:
        names[f"{e['component']} {'|'.join(sorted(e['group']))}"] = e["probability"]
        for name, of in e["parameters"].items():
            estimates[f"{e['component']}.{e['effect']}.{name}"] = [of["mean"], of["sd"]]
    errors = {n: of["heldout"] for n, of in fit.items() if of.get("heldout")}
    for commands, measured in case.held_out:
        found = predict(read_commands(commands), None, file)
        true = np.genfromtxt(measured, delimiter=",", names=True, deletechars="")
        for joint, angle in zip(found.recordings[0].joints, found.angles[0].T, strict=True):
            square = np.nanmean((angle - true[f"{joint}.position_rad"]) ** 2)
            errors[f"{joint} in {measured.stem}"] = float(np.sqrt(square))
    verdict = content.get("verdict", "done")
    return {"verdict": verdict, "names": names, "estimates": estimates, "errors": errors}


def stated(model: dict[str, Any], plain: dict[str, Any]) -> Iterator[tuple[str, list[float]]]:
    """Estimates of a model by name: the value and its standard deviation, 0 if it is not stated."""

    def deviation(bounds: list[float | None] | None) -> float:
        low, high = bounds or (None, None)
        return 0.0 if low is None or high is None else (high - low) / IN_90

    for joint, of in model["joints"].items():
        values = {n: of[n] for n in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")}
        values |= {f"motor.{n}": x for n, x in of.get("motor", {}).items()}
        for name, value in values.items():
            sd = deviation(of["interval"].get(name)) or plain.get(f"{joint}.{name}", [0.0, 0.0])[1]
            yield f"{joint}.{name}", [value, sd]
    for name, bounds in model["body"].get("interval", {}).items():
        if None not in bounds:
            yield name, [sum(bounds) / 2, deviation(bounds)]


def rounded(tree: Any) -> Any:  # noqa: ANN401 - any JSON
    """The same with numbers of four digits."""
    if isinstance(tree, dict):
        return {name: rounded(x) for name, x in tree.items()}
    if isinstance(tree, list):
        return [rounded(x) for x in tree]
    return float(f"{tree:.4g}") if isinstance(tree, float) else tree


def pace_s() -> float:
    """Processor time of a fixed calculation, which tells how fast the machine is just now."""
    start = time.process_time()
    sum(math.sin(k) for k in range(400_000))
    return time.process_time() - start


def cpu_s(of_case: dict[str, Any]) -> float:
    """Processor time of all verbs of a case; the longest are run first."""
    return sum(answer["cpu_s"] for verb, answer in of_case.items() if verb != INPUTS)


@cache
def warmed_up() -> None:
    """Import and compile what the verbs share, so that no case counts it."""
    folder = ROOT / "datasets" / "servo_steps"
    call = [str(folder / "steps.csv"), "--robot", str(folder / "robot.toml")]
    called(["diagnose", *call, "--no-page", "--out", str(BUILD / "warm_up.json")])


def sha(*parts: bytes) -> str:
    """A short hash."""
    return hashlib.sha256(b"".join(parts)).hexdigest()[:12]


def inputs(case: Case) -> str:
    """Hash of the files and the verbs of a case."""
    files = [*case.recordings, *(path for pair in case.held_out for path in pair)]
    files += [case.robot] if case.robot else []
    return sha(*(p.read_bytes() for p in files if p.is_file()), repr(case.verbs).encode())


def run(todo: list[Case], processes: int) -> Answers:
    """Answers of cases; those that an earlier run of the same code has are read."""
    packages = [p for name in ("sim2real", "sim") for p in (ROOT / name).rglob("*.py")]
    kept = BUILD / sha(*(path.read_bytes() for path in sorted(packages)))
    files = {case.name: kept / case.name / f"{inputs(case)}.json" for case in todo}
    missing = [(case, files[case.name]) for case in todo if not files[case.name].exists()]
    list(spread(answer_all, missing, processes, in_order=False))
    return {name: json.loads(path.read_text()) for name, path in files.items()}


def main() -> None:
    """Run, compare or write."""
    options = command_line(
        __doc__, only=("", "cases with this in the name"), processes=2,
        write=(False, "store today's answers"),
    ).parse_args()  # fmt: skip
    chosen = [case for case in cases(BUILD) if options.only in case.name]
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    chosen.sort(key=lambda case: -cpu_s(stored.get(case.name, {})))
    found = run(chosen, options.processes)
    for line in report(stored, found, {case.name: case.truth for case in chosen}):
        print(line)
    if options.write:
        lines = [f"{json.dumps(n)}: {json.dumps(of)}" for n, of in sorted((stored | found).items())]
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main()
