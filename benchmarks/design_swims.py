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
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

POOL = Path(__file__).resolve().parents[1] / "datasets" / "pool"
sys.path[:0] = [str(POOL), str(POOL.parents[1])]

from camera import reported, seen  # noqa: E402
from drawn import Case, Drawn, case_of, command_of, robot_of, start_of  # noqa: E402
from sealed import _component  # noqa: E402
from truth import Truth  # noqa: E402
from world import World  # noqa: E402

from benchmarks.pool_decisions import judged  # noqa: E402
from sim.design.design_swim import design_swim  # noqa: E402
from sim.inference.coordinates import SwimSimulator  # noqa: E402
from sim.inference.diagnose_swims import diagnosis_of  # noqa: E402
from sim.inference.in_water import (  # noqa: E402
    CELL_M,
    robot_in_water,
    simulate_in_water,
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
WATERS = ("water_1.npz", "water_2.npz")


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
    water_cell_m: float
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


class Known(NamedTuple):
    """What a diagnosis of a robot's swims starts from."""

    model: Model
    simulate: SwimSimulator
    prior: SwimPrior
    law_error: LawError


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
        made = simulate_in_water(
            bench.drawn.robot, bench.model, swims,
            cell_m=options.water_cell_m, device=options.device,
        )  # fmt: skip
        if name == "water_1.npz":
            made = with_nearest_law(bench.drawn.robot, bench.model, made, threads=1)
        write_water(file, made)


def diagnosed(bench: Bench, paths: Sequence[Path], known: Known) -> tuple[Decided, Diagnosis]:
    """The diagnosis of swims together, with references."""
    swims, robot = [read(bench, path) for path in paths], bench.drawn.robot
    found = searched(swims, known.model, robot, known.simulate, known.prior)
    decided = decide(raw(found, referred=True), known.law_error.decisions)
    return decided, diagnosis_of(found, robot, known.law_error, referred=True)


def run_robot(options: Options, number: int) -> str:
    """All steps of one robot."""
    began = time.perf_counter()
    bench = bench_of(options, number)
    done = bench.path(None, "rows.json")
    if done.exists():
        return f"robot {number}: there"
    rng = np.random.default_rng([options.seed, number, 1])
    J = len(bench.drawn.robot.joints)
    plain = Case("null", {}, {}, True, bench.cases[0].camera)
    # references first: the twin's law is fitted to the first two
    wanted = [(bench.path(None, f"reference_{n}.csv"), plain) for n in range(2)]
    for name in ("first", "usual"):
        wanted += [(bench.path(k, f"{name}.csv"), case) for k, case in enumerate(bench.cases)]
    given = [
        (path, case, command_of(rng, J, CONTROL_S, options.seconds), start_of(rng, case))
        for path, case in wanted
    ]
    swim(options, bench, given, [options.seed, number, 2])
    in_water(options, bench, "water_1.npz", [path for path, _ in wanted])
    print(f"robot {number}: first swims, {time.perf_counter() - began:.0f} s", flush=True)
    known = known_of(options, bench, ("water_1.npz",))
    for k, case in enumerate(bench.cases):
        if not bench.path(k, "first_row.json").exists():
            first_row(options, bench, number, k, case, known)
    print(f"robot {number}: designed, {time.perf_counter() - began:.0f} s", flush=True)
    paths = [bench.path(k, "designed.csv") for k in range(len(bench.cases))]
    commands = [np.load(bench.path(k, "command.npy")) for k in range(len(bench.cases))]
    swims = zip(paths, bench.cases, commands, [np.zeros(3)] * len(paths), strict=True)
    swim(options, bench, list(swims), [options.seed, number, 3])
    in_water(options, bench, "water_2.npz", paths)
    known = known_of(options, bench, WATERS, known.prior)
    rows = [second_row(bench, k, known) for k in range(len(bench.cases))]
    done.write_text(json.dumps(rows, indent=1) + "\n")
    return f"robot {number}: {len(rows)} cases, {time.perf_counter() - began:.0f} s"


def known_of(
    options: Options, bench: Bench, files: Sequence[str], prior: SwimPrior | None = None
) -> Known:
    """What a diagnosis of the robot's swims starts from; the prior is learned from references."""
    law_error = read_law_error(IN_WATER if options.water else FILE)
    waters = [bench.path(None, name) for name in files] if options.water else []
    model, simulate = robot_in_water(bench.drawn.robot, bench.model, waters, threads=1)
    if prior is None:
        references = [read(bench, bench.path(None, f"reference_{n}.csv")) for n in range(2)]
        prior = learned(references, model, bench.drawn.robot, simulate, law_error)
    return Known(model, simulate, prior, law_error)


def first_row(
    options: Options, bench: Bench, number: int, k: int, case: Case, known: Known
) -> None:
    """Diagnose the first swim of a case, design the second, and keep both."""
    decided, first = diagnosed(bench, [bench.path(k, "first.csv")], known)
    assert first.swim_rivals is not None
    start = time.process_time()
    design = design_swim(
        first.swim_rivals, first.model, bench.drawn.robot,
        seconds=options.seconds, again=True, seed=number, threads=1, **options.search,
    )  # fmt: skip
    (body,) = design.joints
    np.save(bench.path(k, "command.npy"), body.command)
    row = {
        "case": f"{number}.{k}", "kind": case.kind, "effects": case.effects,
        "strength": case.strength, "first": outcome(decided, first), "stated": body.content(),
        "design_cpu_s": time.process_time() - start,
    }  # fmt: skip
    bench.path(k, "first_row.json").write_text(json.dumps(row) + "\n")


def second_row(bench: Bench, k: int, known: Known) -> dict[str, Any]:
    """Diagnose both swims of a case, with each second swim."""
    row: dict[str, Any] = json.loads(bench.path(k, "first_row.json").read_text())
    for arm in ARMS:
        file = bench.path(k, f"{arm}_row.json")
        if not file.exists():
            paths = [bench.path(k, "first.csv"), bench.path(k, f"{arm}.csv")]
            decided, both = diagnosed(bench, paths, known)
            assert both.swim_rivals is not None
            found = {frozenset(one.effects): one.probability for one in both.swim_rivals.sets}
            told = separations("body", [Fields("design", "", row["stated"])], found)
            kept = outcome(decided, both) | {"told": [vars(one) for one in told]}
            file.write_text(json.dumps(kept) + "\n")
        row[arm] = json.loads(file.read_text())
    return row


def outcome(decided: Decided, diagnosis: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says of a case."""
    p = np.array(list(decided.sets.values()))
    return {
        "verdict": diagnosis.verdict,
        "named": [{"group": one.group, "probability": one.probability} for one in decided.named],
        "sets": sorted(
            ([[list(name) for name in sorted(s)], x] for s, x in decided.sets.items()),
            key=lambda one: -one[1],
        )[:12],
        "entropy_nats": float(-np.sum(p * np.log(np.maximum(p, 1e-300)))),
    }


def report(out: Path) -> None:
    """Print what each second swim has told."""
    files = sorted(out.glob("robot_*/rows.json"))
    rows = [row for path in files for row in json.loads(path.read_text())]
    if not rows:
        return
    cpu_s = np.mean([row["design_cpu_s"] for row in rows])
    before, after = (
        np.mean([row["stated"][f"entropy_{when}_nats"] for row in rows])
        for when in ("before", "after")
    )
    print(f"{len(rows)} cases; a design takes {cpu_s:.0f} s of a core, and expects entropies over")
    print(f"the open sets of {before:.2f} nats before and at most {after:.2f} after the swim")
    for arm in ("first", *ARMS):
        cases, truths = [], []
        for row in rows:
            hidden = sorted(
                [effect.partition(".")[0], _component(effect)] for effect in row["effects"]
            )
            effects = [{"effect": effect, "component": of} for effect, of in hidden]
            truth = {"kind": row["kind"], "oracle": {"llr_total": np.inf}, "effects": effects}
            named = [SimpleNamespace(**one) for one in row[arm]["named"]]
            said: Any = SimpleNamespace(verdict=row[arm]["verdict"], named=named)
            cases.append((truth, said))
            truths.append(sum(p for names, p in row[arm]["sets"] if names == hidden))
        found = judged(cases)
        print(
            f"{arm:9s} entropy {np.mean([row[arm]['entropy_nats'] for row in rows]):.2f} nats, "
            f"probability of the true set {np.mean(truths):.2f}, "
            f"right group first {found['group_first']:.2f}, both of two {found['both']:.2f}, "
            f"wrong names at 0.9 {found['wrong']:.3f}"
        )
    for low, high in ((0.5, 0.7), (0.7, 0.9), (0.9, 1.001)):
        for arm in ARMS:
            right = [
                set(told["favoured"]) == set(row["effects"])
                for row in rows
                for told in row[arm]["told"]
                if set(row["effects"]) in (set(told["first"]), set(told["second"]))
                and low <= told["expected"] < high
            ]
            if right:
                share = f"the true set favoured in {np.mean(right):.2f} of {len(right)}"
                print(f"{arm:9s} pairs with it that are expected with {low:g} to {high:g}: {share}")


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
    parser.add_argument("--water-cell-m", type=float, default=CELL_M)
    parser.add_argument("--drawn", type=int, default=96)
    parser.add_argument("--rounds", type=int, default=4)
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
                    devices[n % len(devices)], options.water, options.water_cell_m, search,
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
