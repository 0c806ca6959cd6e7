"""A second recording that is designed, against a random one.

python benchmarks/design_rivals.py --benches 150 --processes 32 --out DIR

Benches of one servo are drawn from the plants of ``datasets/foreign``, which share no dynamics with
the library, with one or two effects and a short, gentle first recording (``open_cases.py`` there).
Benches stay that it leaves ambiguous, unexplained with the truth among the sets that are open, or
with one of two effects found. Then each arm makes a second recording of the same bench and length,
with the same loads to choose from, and both recordings are diagnosed together:

designed   ``sim2real.design``: commands and load with the least expected entropy over the open sets
random     one command of the families that designs start from, drawn at random, the load as it is

A designed recording states the sets that were open, and the diagnosis of both recordings tries
them in any case and holds out ends of recordings only. The others state nothing; with ``--stated``
they are diagnosed once more with the same sets stated: what remains of the difference is due to the
commands and the load alone.

A verdict is right if the first effect is the hidden one, alone or at the head of its group; of two
effects, if each has an entry of its own. Nuisances that every servo of these plants has (irregular
timing, cogging, friction) count neither for a verdict nor against it. Effects are detectable if an
oracle that knows the plant, its parameters and its noise detects them in the same recordings
(``datasets/foreign/knower.py``).

Answers are kept, one file a bench, and a bench that has one is not made again: ``--benches 0`` only
writes the table of those that are there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
# This folder has a file of the name of a package that numba imports.
sys.path[:] = [
    str(DATASETS / "foreign"),
    str(DATASETS / "concealed"),
    *(path for path in sys.path if Path(path or ".").resolve() != Path(__file__).parent.resolve()),
]

import knower  # noqa: E402
from bench import Load as StatedLoad  # noqa: E402
from bus import draw_bus, draw_packets  # noqa: E402
from files import answer, robot_toml, sidecar, table  # noqa: E402
from foreign_cases import ForeignCase, _ticks, nuisances  # noqa: E402
from foreign_world import Take, acting_on, recorded  # noqa: E402
from grade import DETECTABLE, LIKELY, _both, _entry, _named  # noqa: E402
from open_cases import draw_open_case  # noqa: E402

from sim2real.design.candidates import draw  # noqa: E402
from sim2real.design.contexts import AS_IT_IS, Context  # noqa: E402
from sim2real.design.limits import CommandLimits, holding, limits_of  # noqa: E402
from sim2real.design.rivals import RivalObjective  # noqa: E402
from sim2real.design.tell_apart import design_for_rivals, forecast  # noqa: E402
from sim2real.diagnose.decision import DECISION  # noqa: E402
from sim2real.diagnose.diagnose import Case, examined  # noqa: E402
from sim2real.diagnose.missing.open_sets import rival_sets  # noqa: E402
from sim2real.diagnose.page.wording import diagnosis  # noqa: E402
from sim2real.diagnose.result import Diagnosis, write_diagnosis  # noqa: E402
from sim2real.diagnose.rival_sets import with_open_sets  # noqa: E402
from sim2real.errors import InputError  # noqa: E402
from sim2real.recording import Load, read_recording  # noqa: E402
from sim2real.robot import Robot, read_robot  # noqa: E402

Row = dict[str, Any]

ARMS = ("designed", "random")
STATED = " + sets"
"""Added to the name of an arm that is diagnosed with the open sets stated."""
SECONDS = 16.0
"""Duration of the second recording."""
CONTEXTS = ("added_inertia", "added_weight")
"""Loads that are to be had: twice the inertia, and a weight of 50 g on an arm of 0.1 m."""
LEFT = 0.05
"""Probability from which an effect that was not named remains a rival."""
STATES = ("ambiguous", "unexplained", "one of two")
"""What a first recording says of a bench that asks for a second."""
JOINT = "j1"


@dataclass
class Bench:
    """A bench and what its first recording says."""

    case: ForeignCase
    robot: Robot
    folder: Path
    first: Diagnosis
    state: str
    seed: list[int]


def write_take(case: ForeignCase, name: str, folder: Path) -> Path:
    """Write one recording of a bench with its JSON."""
    path = folder / f"{name}.csv"
    path.write_text(table(case.takes[name]))
    path.with_suffix(".json").write_text(json.dumps(sidecar(case, name)))
    return path


def diagnosed(paths: Sequence[Path], robot: Robot, first: Path | None = None) -> Diagnosis:
    """The diagnosis of a bench from its recordings.

    ``first`` is an earlier diagnosis, whose open sets are stated.
    """
    recordings = [read_recording(path) for path in paths]
    if first is not None:
        recordings = with_open_sets(recordings, first)
    ((case, joints),) = examined([Case(recordings, robot)])
    found = diagnosis(case, joints, DECISION.negligible, 0)
    (joint,) = joints
    if joint.finding.mismatch:
        found = replace(found, rival_sets=(rival_sets(joint.joint, joint.finding),))
    return found


def graded(case: ForeignCase, found: Diagnosis, folder: Path) -> Row:
    """Compare a diagnosis with the concealed effects."""
    write_diagnosis(found, folder / "diagnosis.json", "enriched.json")
    content = json.loads((folder / "diagnosis.json").read_text())
    hidden = answer(case, "bench")["effects"]
    there = [*hidden, *nuisances(case)]
    entries = [_entry(given, there) for given in _named(content)]
    likely = [entry for entry in entries if entry["probability"] >= LIKELY]
    both = _both(hidden, likely)
    of_hidden = [_entry(given, hidden)["right"] for given in _named(content)]
    counted = (
        hit for hit, entry in zip(of_hidden, entries, strict=True) if hit or not entry["right"]
    )
    right = next(counted, False)
    rivals = {e for entry in likely for e in entry["group"][1:]}
    rivals |= {r["effect"] for r in content["rivals"] if r["probability"] >= LEFT}
    return {
        "verdict": found.verdict,
        "right": right if len(hidden) == 1 else both["both"],
        "found": both["found"],
        "wrong": both["wrong"],
        "rivals": len(rivals - {h["effect"] for h in hidden}),
        "named": [(e["effect"], round(e["probability"], 3), e["group"]) for e in likely],
    }


def state_of(case: ForeignCase, found: Diagnosis, verdict: Row) -> str:
    """Why a first recording asks for a second; empty where it does not."""
    open_effects = {e for j in found.rival_sets for s in j.sets for e in s.effects}
    open_effects |= {r.effect for r in found.rivals}
    hidden = {h.effect for h in case.hidden}
    if not found.rival_sets:
        return ""
    if len(hidden) == 2 and verdict["found"] == 1:
        return "one of two"
    if found.verdict == "ambiguous" and hidden & {e for x in found.effects for e in x.group}:
        return "ambiguous"
    unexplained = found.verdict in ("unexplained", "partly_explained")
    if unexplained and not verdict["right"] and hidden <= open_effects:
        return "unexplained"
    return ""


def looked_at(seed: list[int], folder: Path) -> Bench | str:
    """A bench that asks for a second recording, or the verdict of one that does not."""
    case = draw_open_case(np.random.default_rng([*seed, 0]))
    path = write_take(case, "a", folder)
    (folder / "robot.toml").write_text(robot_toml(case))
    robot = read_robot(folder / "robot.toml")
    found = diagnosed([path], robot)
    state = state_of(case, found, graded(case, found, folder))
    return Bench(case, robot, folder, found, state, seed) if state else found.verdict


def second(bench: Bench, arm: str) -> tuple[np.ndarray, str, Row]:
    """Set-points of an arm's recording (T,), its context, and notes."""
    rivals = bench.first.rival_sets[0]
    rng = np.random.default_rng([*bench.seed, 1])
    limits = replace(limits_of(bench.robot, None, JOINT), period_s=rivals.period_s)
    start, context = time.perf_counter(), "none"
    if arm == "designed":
        offered = [_context(name, rivals.load) for name in CONTEXTS]
        contexts = [c for c in offered if _can_hold(c, limits, bench.robot)]
        given = {"contexts": contexts, "seconds": SECONDS, "again": True}
        design = design_for_rivals([rivals], bench.robot, **given)
        command = design.joints[0].command
        context = "none" if design.context == AS_IT_IS else design.context.name
    else:
        command = draw(rng, 1, limits, SECONDS)[0]
    seconds = time.perf_counter() - start
    objective = RivalObjective(rivals, _context(context, rivals.load))
    remaining = forecast(objective, command).remaining
    return command, context, {"remaining": remaining, "seconds": seconds}


def _can_hold(context: Context, limits: CommandLimits, robot: Robot) -> bool:
    """Whether the servo can hold the load of a context."""
    with suppress(InputError):
        holding(limits, context.loads[JOINT], robot)
        return True
    return False


def _context(name: str, load: Load) -> Context:
    return Context(name, {JOINT: loaded(load, name)}) if name != "none" else AS_IT_IS


def loaded(load: Load, context: str) -> Load:
    """What the shaft turns in a context."""
    if context == "added_inertia":
        return replace(load, inertia_kgm2=2 * load.inertia_kgm2)
    if context == "added_weight":
        mass, arm = 0.05, 0.1
        moment = load.pendulum_mass_kg * load.pendulum_length_m + mass * arm
        total = load.pendulum_mass_kg + mass
        return Load(load.inertia_kgm2 + mass * arm**2, total, moment / total)
    return load


def recorded_again(
    bench: Bench, arm: str, command: np.ndarray, context: str, *, stated: bool
) -> dict[str, Row]:
    """Record a second time, diagnose both recordings, and ask the oracle; rows by arm."""
    case, rng = bench.case, np.random.default_rng([*bench.seed, 2])
    period = bench.first.rival_sets[0].period_s
    first, servo = case.takes["a"], case.servos[0]
    t = _ticks(1 / period, command.size * period, None, rng)[: command.size]
    packets = draw_packets(draw_bus(rng), t.size, 1, rng)
    case.takes["b"] = Take(t, np.round(command, 6)[:, None], packets, first.clock)
    given = servo.loads["a"]
    load = loaded(Load(**vars(given)), context)
    servo.loads["b"] = StatedLoad(load.inertia_kgm2, load.pendulum_mass_kg, load.pendulum_length_m)
    reading = case.readings("b")[:, 0]
    if not np.isfinite(reading).all():
        unstable = {"right": False, "unstable": True}
        return {label: unstable for label in (arm, arm + STATED)}
    case.takes["b"].measured = recorded(
        case.takes["b"], reading, servo, acting_on(case.hidden, 0), rng
    )[:, None]
    known = knower.consult(case)
    least = min(known["llr_of_each"].values()) if "llr_of_each" in known else known["llr_total"]
    practical = known.get("practical_of_each") or {"it": known["practical"]}
    oracle = {"llr": float(least), "practical": all(practical.values())}
    folder = bench.folder / arm
    folder.mkdir()
    path = write_take(case, "b", folder)
    first = bench.folder / "diagnosis.json"
    open_sets = {arm: first if arm == "designed" else None}
    if stated and arm != "designed":
        open_sets[arm + STATED] = first
    rows = {}
    for label, earlier in open_sets.items():
        found = diagnosed([bench.folder / "a.csv", path], bench.robot, earlier)
        entropy = found.rival_sets[0].entropy if found.rival_sets else 0.0
        rows[label] = graded(case, found, folder) | oracle | {"entropy": entropy}
    return rows


def answered(seed: list[int], *, stated: bool = False) -> Row:
    """Results of one bench; ``stated`` as the option."""
    start = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        bench = looked_at(seed, Path(name))
        if isinstance(bench, str):
            spent = time.process_time() - start
            return {"seed": seed, "state": "", "verdict": bench, "processor_s": spent}
        case, first = bench.case, bench.first
        row: Row = {
            "seed": seed,
            "state": bench.state,
            "plant": case.plant,
            "hidden": [(h.effect, h.strength) for h in case.hidden],
            "first": graded(case, first, bench.folder) | {"entropy": first.rival_sets[0].entropy},
            "sets": [(s.effects, s.probability) for s in first.rival_sets[0].sets],
        }
        for arm in ARMS:
            command, context, note = second(bench, arm)
            found = recorded_again(bench, arm, command, context, stated=stated)
            row |= {label: note | {"context": context} | one for label, one in found.items()}
    return row | {"processor_s": time.process_time() - start}


def summary(rows: Sequence[Row]) -> Row:
    """Shares of benches by arm, and of those with effects that the oracle detects."""
    out: Row = {}
    groups = {"all": rows}
    groups |= {f"{n} hidden": [r for r in rows if len(r["hidden"]) == n] for n in (1, 2)}
    groups |= {state: [r for r in rows if r["state"] == state] for state in STATES}
    for name, some in groups.items():
        out[name] = {"benches": len(some)}
        same = [r for r in some if r["designed"].get("llr", 0) >= DETECTABLE]
        for arm in (*ARMS, *(arm + STATED for arm in ARMS[1:])):
            if any(arm not in r for r in some):
                continue
            detectable = [r for r in some if r[arm].get("llr", 0) >= DETECTABLE]
            matter = [r for r in detectable if r[arm]["practical"]]
            out[name][arm] = {
                "right": _share(r[arm]["right"] for r in some),
                "right of detectable": _share(r[arm]["right"] for r in detectable),
                "right of that, of practical size": _share(r[arm]["right"] for r in matter),
                "right of detectable in the designed": _share(r[arm]["right"] for r in same),
                "detectable": len(detectable),
                "reduction of entropy over the expected": _slope(some, arm),
                **{
                    label: _mean(r[arm].get(label, np.nan) for r in some)
                    for label in ("rivals", "wrong", "entropy", "seconds")
                },
            }
    return out


def _slope(rows: Sequence[Row], arm: str) -> float | None:
    """Regression through zero of the reduction of entropy on that which the design expected."""
    given = [r for r in rows if np.isfinite(r[arm]["remaining"]) and "entropy" in r[arm]]
    before, expected, found = (
        np.array([r[name][key] for r in given])
        for name, key in (("first", "entropy"), (arm, "remaining"), (arm, "entropy"))
    )
    size = float(np.sum((before - expected) ** 2))
    return round(float(np.sum((before - expected) * (before - found))) / size, 3) if size else None


def _share(values: Iterable[bool]) -> float | None:
    given = [bool(x) for x in values]
    return round(sum(given) / len(given), 3) if given else None


def _mean(values: Iterable[float]) -> float | None:
    given = [float(x) for x in values if np.isfinite(x)]
    return round(float(np.mean(given)), 3) if given else None


def main() -> None:
    """Answer benches until enough ask for a second recording; write the shares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--benches", type=int, default=150, metavar="N")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    parser.add_argument("--seed", type=int, default=1, help="development: below 1000")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--stated", action="store_true", help="state the open sets to all arms too")
    parser.add_argument("--most", type=int, default=100_000, help="benches drawn at most")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    files = options.out / f"seed_{options.seed}"
    files.mkdir(exist_ok=True)
    kept = {path.stem: json.loads(path.read_text()) for path in sorted(files.glob("*.json"))}
    rows = [row for row in kept.values() if row["state"]]
    numbers = (k for k in itertools.count() if f"{k:05d}" not in kept)
    spawn, start, drawn = multiprocessing.get_context("spawn"), time.perf_counter(), len(kept)
    with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
        running: dict[Future[Row], int] = {}
        while True:
            wanted = len(rows) < options.benches
            while wanted and len(running) < options.processes and drawn < options.most:
                k, drawn = next(numbers), drawn + 1
                job = pool.submit(answered, [options.seed, k], stated=options.stated)
                running[job] = k
            if not running:
                break
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                k, error = running.pop(done), done.exception()
                row = {"state": "", "failed": repr(error)} if error else done.result()
                (files / f"{k:05d}.json").write_text(json.dumps(row, default=float) + "\n")
                rows += [row] if row["state"] else []
                took = f"{time.perf_counter() - start:.0f} s"
                print(f"{len(rows)} of {drawn} benches, {took}", flush=True)
    found = json.dumps(summary(rows) | {"drawn": drawn}, indent=1)
    (options.out / "summary.json").write_text(found + "\n")
    print(found)


if __name__ == "__main__":
    main()
