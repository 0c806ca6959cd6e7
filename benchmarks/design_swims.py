"""A second swim that is designed, against a second swim of the usual commands.

python benchmarks/design_swims.py DIR --robots 16 --processes 16 --device cuda:0 [--water]

Robots and pools are drawn as those of the sealed swims (``datasets/pool``), from development seeds.
Each case conceals a resistance (drag, friction or added mass), alone or with another effect. Its
first swim is diagnosed with two reference swims; then the same robot swims again by the usual
commands, and by those of a design from the diagnosis, both as long, and each pair of swims is
diagnosed together. With ``--water`` the fluid simulates the commands too, in cells and with
settings of its own, and the twin predicts only differences (``sim.inference.in_water``).

What a robot's steps have written is not made again, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

POOL = Path(__file__).resolve().parents[1] / "datasets" / "pool"
sys.path[:0] = [str(POOL), str(POOL.parents[1])]

from camera import reported, seen  # noqa: E402
from drawn import Case, Drawn, case_of, command_of, robot_of, start_of  # noqa: E402
from truth import Truth  # noqa: E402
from world import World  # noqa: E402

from benchmarks.pool_decisions import judged  # noqa: E402
from sim.design.design_swim import design_swim  # noqa: E402
from sim.inference.coordinates import Swum  # noqa: E402
from sim.inference.diagnose_swims import diagnosis_of  # noqa: E402
from sim.inference.in_water import (  # noqa: E402
    robot_in_water,
    swum_in_water,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import FILE, IN_WATER, LawError, read_law_error  # noqa: E402
from sim.inference.searched import learned, raw, searched  # noqa: E402
from sim.inference.swim_decision import Decided, decide  # noqa: E402
from sim.inference.swims import Swim, swim_of  # noqa: E402
from sim.inference.twin_search import SwimPrior  # noqa: E402
from sim.robot.swimmer import CONTROL_S  # noqa: E402
from sim2real.diagnose.result import Diagnosis  # noqa: E402
from sim2real.diagnose.separation import separations  # noqa: E402
from sim2real.model import JointModel, Model  # noqa: E402
from sim2real.recording import Recording, read_recording, write_recording  # noqa: E402
from sim2real.structured import Fields  # noqa: E402

RESISTANCES = ("linear_drag", "surface_friction", "form_drag", "added_mass")
ARMS = ("usual", "designed")


@dataclass(frozen=True)
class Options:
    """What all robots share."""

    out: Path
    seed: int
    cases: int
    seconds: float
    cell_m: float
    device: str
    water: bool
    search: dict[str, int]


@dataclass(frozen=True)
class Bench:
    """One robot, with what is concealed in its cases."""

    folder: Path
    drawn: Drawn
    cases: list[Case]
    model: Model

    def path(self, k: int | None, name: str) -> Path:
        """File of a case, or of the robot."""
        return self.folder / name if k is None else self.folder / f"case_{k}" / name


def bench_of(options: Options, number: int) -> Bench:
    """Draw a robot and its cases: the first conceals a resistance, the others one more effect."""
    rng = np.random.default_rng([options.seed, number])
    drawn = robot_of(rng, f"robot {number}")
    cases: list[Case] = []
    while len(cases) < options.cases:
        kind = "double" if cases else "single"
        name = RESISTANCES[int(rng.integers(len(RESISTANCES)))]
        if name == "surface_friction":
            name += f".{drawn.robot.links[-1].material}"
        case = case_of(kind, name, rng, drawn.robot)
        if any(effect.startswith(RESISTANCES) for effect in case.effects):
            cases.append(case)
    rows = zip(drawn.robot.joints, *(drawn.bench[n] for n in ("kp", "kd", "latency")), strict=True)
    model = Model(joints={j.name: JointModel(kp, kd, late, 0.002) for j, kp, kd, late in rows})
    return Bench(options.out / f"robot_{number:02d}", drawn, cases, model)


def swim(
    options: Options,
    bench: Bench,
    swims: Sequence[tuple[Path, Case, np.ndarray, np.ndarray]],
    seed: Sequence[int],
) -> None:
    """Swim commands (T, J) from poses (3,) in the robot's pool, and write what is seen of them."""
    swims = [one for one in swims if not one[0].exists()]
    if not swims:
        return
    rng = np.random.default_rng(seed)
    truths = [Truth(path.stem, case.effects, **bench.drawn.servos) for path, case, *_ in swims]  # type: ignore[arg-type]
    world = World(
        truths, device=options.device, cell_m=options.cell_m, rng=rng,
        robot=bench.drawn.robot, water=bench.drawn.water,
    )  # fmt: skip
    J = len(bench.drawn.robot.joints)
    world.reset(np.array([start for *_, start in swims]), np.zeros((len(swims), J)))
    poses, joints = [], []
    sent = np.stack([command for _, _, command, _ in swims], axis=1)
    for row in sent:
        pose, joint = world.where()
        poses.append(pose)
        joints.append(joint)
        world.step(row)
    t = CONTROL_S * np.arange(len(sent))
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    for e, (path, case, command, _) in enumerate(swims):
        angles = np.array(joints)[:, e]
        shown = seen(t, np.array(poses)[:, e], angles, case.effects, rng, case.camera)
        recording = Recording(
            name=path.stem, kind="pool", joints=tuple(j.name for j in bench.drawn.robot.joints),
            t=t, command=command, position=reported(angles, rng), medium="water",
            source="Simulated, not measured: benchmarks/design_swims.py.",
            columns=dict(zip(names, shown.T, strict=True)),
        )  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        write_recording(recording, path)


def read(bench: Bench, path: Path) -> Swim:
    """A swim that was recorded."""
    return swim_of(read_recording(path), bench.drawn.robot)


def in_water(options: Options, bench: Bench, name: str, paths: Sequence[Path]) -> None:
    """Let the fluid of the library swim the commands of recordings, if asked."""
    file = bench.path(None, name)
    if options.water and not file.exists():
        swims = [read(bench, path) for path in paths]
        made = swum_in_water(bench.drawn.robot, bench.model, swims, device=options.device)
        if name == "water_1.npz":
            made = with_nearest_law(bench.drawn.robot, bench.model, made, threads=1)
        write_water(file, made)


def diagnosed(
    bench: Bench, paths: Sequence[Path], model: Model, simulate: Swum, prior: SwimPrior,
    law_error: LawError,
) -> tuple[Diagnosis, Decided]:  # fmt: skip
    """The diagnosis of swims together, with references."""
    swims = [read(bench, path) for path in paths]
    found = searched(swims, model, bench.drawn.robot, simulate, prior)
    decided = decide(raw(found, referred=True), law_error.decisions)
    return diagnosis_of(found, bench.drawn.robot, law_error, referred=True), decided


def run_robot(options: Options, number: int) -> str:
    """All steps of one robot."""
    began = time.perf_counter()
    bench = bench_of(options, number)
    if bench.path(None, "rows.json").exists():
        return f"robot {number}: there"
    rng = np.random.default_rng([options.seed, number, 1])
    J, robot = len(bench.drawn.robot.joints), bench.drawn.robot
    plain = Case("null", {}, {}, True, bench.cases[0].camera)
    swims = [(k, case, "first") for k, case in enumerate(bench.cases)]
    swims += [(k, case, "usual") for k, case in enumerate(bench.cases)]
    wanted = [(bench.path(k, f"{name}.csv"), case) for k, case, name in swims]
    wanted += [(bench.path(None, f"reference_{n}.csv"), plain) for n in range(2)]
    given = [
        (path, case, command_of(rng, J, CONTROL_S, options.seconds), start_of(rng, case))
        for path, case in wanted
    ]
    swim(options, bench, given, [options.seed, number, 2])
    # references first: the twin's law is fitted to the first two
    in_water(options, bench, "water_1.npz", [path for path, _ in reversed(wanted)])
    print(f"robot {number}: first swims, {time.perf_counter() - began:.0f} s", flush=True)
    law_error = read_law_error(IN_WATER if options.water else FILE)
    files = [bench.path(None, "water_1.npz")] if options.water else []
    model, simulate = robot_in_water(robot, bench.model, files, threads=1)
    references = [read(bench, path) for path, case in wanted if case is plain]
    prior = learned(references, model, robot, simulate, law_error)
    rows: list[dict[str, Any]] = []
    designs = []
    for k, case in enumerate(bench.cases):
        first, before = diagnosed(
            bench, [bench.path(k, "first.csv")], model, simulate, prior, law_error
        )
        assert first.swim_rivals is not None
        start = time.process_time()
        design = design_swim(
            first.swim_rivals, first.model, robot,
            seconds=options.seconds, again=True, seed=number, threads=1, **options.search,
        )  # fmt: skip
        (body,) = design.joints
        rows.append({
            "case": f"{number}.{k}", "kind": case.kind, "effects": case.effects,
            "strength": case.strength, "first": outcome(before, first), "stated": body.content(),
            "design_cpu_s": time.process_time() - start,
        })  # fmt: skip
        designs.append((bench.path(k, "designed.csv"), case, body.command, np.zeros(3)))
    print(f"robot {number}: designed, {time.perf_counter() - began:.0f} s", flush=True)
    swim(options, bench, designs, [options.seed, number, 3])
    in_water(options, bench, "water_2.npz", [path for path, *_ in designs])
    if options.water:
        files.append(bench.path(None, "water_2.npz"))
        model, simulate = robot_in_water(robot, bench.model, files, threads=1)
    for k, row in enumerate(rows):
        for arm in ARMS:
            paths = [bench.path(k, "first.csv"), bench.path(k, f"{arm}.csv")]
            both, decided = diagnosed(bench, paths, model, simulate, prior, law_error)
            row[arm] = outcome(decided, both)
            assert both.swim_rivals is not None
            found = {frozenset(one.effects): one.probability for one in both.swim_rivals.sets}
            told = separations("body", [Fields("design", "", row["stated"])], found)
            row[arm]["told"] = [vars(one) for one in told]
    bench.path(None, "rows.json").write_text(json.dumps(rows, indent=1) + "\n")
    return f"robot {number}: {len(rows)} cases, {time.perf_counter() - began:.0f} s"


def outcome(decided: Decided, diagnosis: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says of a case."""
    p = np.array(list(decided.sets.values()))
    return {
        "verdict": diagnosis.verdict,
        "named": [
            {"group": [list(name) for name in one.group], "probability": one.probability}
            for one in decided.named
        ],
        "sets": sorted(
            ([[list(name) for name in sorted(s)], x] for s, x in decided.sets.items()),
            key=lambda one: -one[1],
        )[:12],
        "entropy_nats": float(-np.sum(p * np.log(np.maximum(p, 1e-300)))),
    }


def report(out: Path) -> None:
    """Print what each second swim has told."""
    rows = [row for path in sorted(out.glob("robot_*/rows.json"))
            for row in json.loads(path.read_text())]  # fmt: skip
    if not rows:
        return
    print(f"{len(rows)} cases, design {np.mean([r['design_cpu_s'] for r in rows]):.0f} s of a core")
    stated = [row["stated"] for row in rows]
    before, after = (np.mean([one[f"entropy_{x}_nats"] for one in stated]) for x in
                     ("before", "after"))  # fmt: skip
    print(f"expected entropy over sets, with even shares: {before:.2f} before, {after:.2f} after")
    for arm in ("first", *ARMS):
        cases, truths = [], []
        for row in rows:
            hidden = [list(_name(effect)) for effect in row["effects"]]
            truth = {
                "kind": row["kind"], "oracle": {"llr_total": np.inf},
                "effects": [{"effect": e, "component": c} for e, c in hidden],
            }  # fmt: skip
            sets = {json.dumps(names): p for names, p in row[arm]["sets"]}
            truths.append(sets.get(json.dumps(sorted(hidden)), 0.0))
            cases.append((truth, _Said(row[arm])))
        found = judged(cases)  # type: ignore[arg-type]
        entropy = np.mean([row[arm]["entropy_nats"] for row in rows])
        print(
            f"{arm:9s} entropy {entropy:.2f} nats, probability of the true set"
            f" {np.mean(truths):.2f} (median {np.median(truths):.2f}), right group first"
            f" {found['group_first']:.2f}, both of two {found['both']:.2f},"
            f" wrong names at 0.9 {found['wrong']:.3f}"
        )
    for low, high in ((0.5, 0.7), (0.7, 0.9), (0.9, 1.001)):
        for arm in ARMS:
            _calibration(rows, arm, low, high)


def _calibration(rows: list[dict[str, Any]], arm: str, low: float, high: float) -> None:
    """Promise beside outcome: of pairs that hold the true set, how often it is favoured."""
    right = []
    for row in rows:
        hidden = {_stated(effect) for effect in row["effects"]}
        for told in row[arm]["told"]:
            pair = [set(told["first"]), set(told["second"])]
            if hidden in pair and low <= told["expected"] < high and told["found"] is not None:
                right.append(set(told["favoured"]) == hidden)
    if right:
        share = np.mean(right)
        print(f"{arm:9s} pairs expected {low:g} to {high:g}: {len(right)}, true {share:.2f}")


class _Said:
    """A kept outcome, as ``judged`` reads decisions."""

    def __init__(self, kept: dict[str, Any]) -> None:
        self.verdict = kept["verdict"]
        self.named = [_Kept(one) for one in kept["named"]]


class _Kept:
    def __init__(self, kept: dict[str, Any]) -> None:
        self.group = [tuple(name) for name in kept["group"]]
        self.probability = kept["probability"]


def _name(effect: str) -> tuple[str, str]:
    from sealed import _component

    return effect.partition(".")[0], _component(effect)


def _stated(effect: str) -> str:
    return effect


def main() -> None:
    """Swim, diagnose, design, swim, diagnose; print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", type=int, default=16)
    parser.add_argument("--cases", type=int, default=2, help="of a robot")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--device", default="cpu", help="one or several, with commas between")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a swim")
    parser.add_argument("--cell-m", type=float, default=0.014)
    parser.add_argument("--seed", type=int, default=40_003)
    parser.add_argument("--water", action="store_true")
    parser.add_argument("--drawn", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=6)
    options = parser.parse_args()
    devices = options.device.split(",")
    search = {"drawn": options.drawn, "rounds": options.rounds}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
        jobs = [
            pool.submit(
                run_robot,
                Options(
                    options.out, options.seed, options.cases, options.seconds, options.cell_m,
                    devices[n % len(devices)], options.water, search,
                ),
                n,
            )
            for n in range(options.robots)
        ]  # fmt: skip
        for job in as_completed(jobs):
            print(job.exception() or job.result(), flush=True)
    report(options.out)


if __name__ == "__main__":
    main()
