"""A second swim that is designed, against a second swim of the usual commands.

python benchmarks/design_swims.py DIR --draw HASHES.json          # a sealed set: seed and hashes
python benchmarks/design_swims.py DIR --processes 32 --device cuda:0,cuda:1 [--water [--again]]
python benchmarks/design_swims.py DIR --report REPORT.json
python benchmarks/design_swims.py DIR --decisions [--water]       # development seeds only

Robots, pools and what their cases conceal are drawn as for the sealed swims (``datasets/pool``),
from a development seed or from one that ``--draw`` has drawn. The first swim of a case is diagnosed
with two reference swims; then the same robot swims again by the usual commands, and by those of a
design from the diagnosis, both as long, and each pair of swims is diagnosed together. With
``--water`` the fluid simulates the commands too, in cells and with settings of its own, and the
twin predicts only differences (``sim.inference.in_water``); with ``--again`` it simulates them once
more with the effects that were found, and they are diagnosed again, as by ``sim2real diagnose`` on
a GPU.

What a robot's steps have written is not made again, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import secrets
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from pathlib import Path
from threading import Semaphore
from typing import Any, NamedTuple

import numpy as np

POOL = Path(__file__).resolve().parents[1] / "datasets" / "pool"
sys.path[:0] = [str(POOL), str(POOL.parents[1])]

from camera import reported, seen  # noqa: E402
from drawn import Case, command_of, start_of  # noqa: E402
from sealed import NUDGE_M  # noqa: E402
from truth import Truth  # noqa: E402
from world import World  # noqa: E402

from benchmarks.design_swims_cases import Bench, Options, bench_of  # noqa: E402
from benchmarks.design_swims_diagnoses import (  # noqa: E402
    WATERS,
    first_row,
    learn,
    second_row,
    swims_of,
)
from benchmarks.design_swims_report import decision_cases, report  # noqa: E402
from benchmarks.pool_decisions import choose  # noqa: E402
from sim.inference.in_water import (  # noqa: E402
    CELL_M,
    read_water_swims,
    simulate_again,
    simulate_in_water,
    write_water,
)
from sim.inference.law_error import FILE, IN_WATER  # noqa: E402
from sim.robot.swimmer import CONTROL_S  # noqa: E402
from sim2real.model import read_model  # noqa: E402
from sim2real.output import write_json  # noqa: E402
from sim2real.recording import Recording, write_recording  # noqa: E402

ARMS = ("usual", "designed")
AT_ONCE = 2
"""Robots that one device simulates at once."""


class Planned(NamedTuple):
    """A swim to make: its file, what is concealed, commands (T, J) and initial pose (3,)."""

    path: Path
    case: Case
    command: np.ndarray
    start: np.ndarray


def variants(case: Case) -> list[dict[str, dict[str, float]]]:
    """What is concealed, the same without each effect, and nothing, each once."""
    every = [case.effects]
    every += [{n: v for n, v in case.effects.items() if n != left} for left in case.effects]
    return every + [{}] * (len(case.effects) > 1)


def swim(
    options: Options, bench: Bench, planned: Sequence[Planned], device: str, seed: Sequence[int]
) -> None:
    """Swim commands in the robot's pool, and write what is seen of them.

    Beside the recordings stand the same swims without noise (``.npz``), with each of ``variants``.
    A swim of which a box was stopped is not written.
    """
    boxes = [(k, effects) for k, one in enumerate(planned) for effects in variants(one.case)]
    first = [next(b for b, (of, _) in enumerate(boxes) if of == k) for k in range(len(planned))]
    rng = np.random.default_rng(seed)
    true: dict[str, Any] = {"areas": bench.drawn.areas, **bench.drawn.servos}
    truths = [Truth(planned[k].path.stem, effects, **true) for k, effects in boxes]
    world = World(
        truths, device=device, cell_m=options.cell_m, rng=rng,
        robot=bench.drawn.robot, water=bench.drawn.water,
    )  # fmt: skip
    begin = np.array([planned[k].start for k, _ in boxes])
    moved = np.setdiff1d(np.arange(len(boxes)), first)  # another wake: nobody can predict it
    begin[moved, 0] += NUDGE_M
    sent = np.stack([planned[k].command for k, _ in boxes], axis=1)
    pose, joint, stopped = world.swim(begin, sent)
    pose[:, moved, 0] -= NUDGE_M
    t = CONTROL_S * np.arange(len(sent))
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    for k, one in enumerate(planned):
        mine = [b for b, (of, _) in enumerate(boxes) if of == k]
        if stopped[mine].any():
            continue
        dice = [*seed, k]
        clean = [
            seen(t, pose[:, b], joint[:, b], boxes[b][1], np.random.default_rng(dice)) for b in mine
        ]
        b = mine[0]
        noisy = np.random.default_rng(dice)
        shown = seen(t, pose[:, b], joint[:, b], one.case.effects, noisy, one.case.camera)
        recording = Recording(
            name=one.path.stem, kind="pool", t=t, command=sent[:, b], medium="water",
            joints=tuple(j.name for j in bench.drawn.robot.joints),
            position=reported(joint[:, b], rng),
            source="Simulated, not measured: benchmarks/design_swims.py.",
            columns=dict(zip(names, shown.T, strict=True)),
        )  # fmt: skip
        one.path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            one.path.with_suffix(".npz"), pose=np.array(clean, np.float32), sent=sent[:, b],
            joint=np.moveaxis(joint[:, mine], 1, 0).astype(np.float32),
        )  # fmt: skip
        write_recording(recording, one.path)


def in_water(options: Options, bench: Bench, name: str, paths: list[Path], device: str) -> None:
    """Simulate the commands of recordings in the fluid of the library, with ``--water``."""
    if options.water:
        swims = [bench.read(path) for path in paths]
        made = simulate_in_water(
            bench.drawn.robot, bench.model, swims, cell_m=options.water_cell_m, device=device
        )
        write_water(bench.path(None, name), made)


def first_swims(options: Options, number: int, device: str) -> None:
    """References, first and usual second swims of a robot."""
    bench = bench_of(options, number)
    rng = np.random.default_rng([options.seed, number, 1])
    J = len(bench.drawn.robot.joints)
    plain = Case("null", {}, {}, True, bench.cases[0].camera)
    # references first: the twin's law is fitted to the first two
    wanted = [(bench.path(None, f"reference_{n}.csv"), plain) for n in range(2)]
    for name in ("first", "usual"):
        wanted += [(bench.path(k, f"{name}.csv"), case) for k, case in enumerate(bench.cases)]
    planned = [
        Planned(path, case, command_of(rng, J, CONTROL_S, options.seconds), start_of(rng, case))
        for path, case in wanted
    ]
    swim(options, bench, planned, device, [options.seed, number, 2])
    paths = [path for path, _ in wanted if path.exists()]
    in_water(options, bench, "water_1.npz", paths, device)


def designed_swims(options: Options, number: int, device: str) -> None:
    """Swim the designed commands of a robot's cases."""
    bench = bench_of(options, number)
    planned = [
        Planned(
            bench.path(k, "designed.csv"), bench.cases[k],
            np.load(bench.path(k, "command.npy")), np.zeros(3),
        )
        for k in bench.complete("first_row.json")
    ]  # fmt: skip
    swim(options, bench, planned, device, [options.seed, number, 3])
    paths = [bench.path(k, "designed.csv") for k in bench.complete("designed.csv")]
    in_water(options, bench, "water_2.npz", paths, device)


def simulate_found(options: Options, number: int, device: str, arm: str) -> None:
    """Simulate the swims of an arm in the fluid, with the effects that were found in each case."""
    bench = bench_of(options, number)
    models, swims = [], []
    for k in bench.complete(f"{arm}_found.json"):
        for path in swims_of(bench, k, arm):
            models.append(read_model(bench.path(k, f"{arm}_found.json")))
            swims.append(bench.read(path))
    if swims:
        water = read_water_swims(*sorted(bench.folder.glob(WATERS)))
        again = simulate_again(
            bench.drawn.robot, models, swims, water, cell_m=options.water_cell_m, device=device
        )
        write_water(bench.path(None, f"again_{arm}.npz"), again)


def run_robot(
    options: Options, number: int, device: str, jobs: Executor, on_devices: Executor,
    free: Semaphore,
) -> str:  # fmt: skip
    """All steps of one robot, each in processes of ``jobs`` or, in the fluid, ``on_devices``."""
    began = time.perf_counter()
    bench = bench_of(options, number)

    def missing(k: int | None, name: str) -> bool:
        return not bench.path(k, name).exists()

    def on_device(step: Callable[..., None], done: str, *more: str) -> None:
        if missing(None, done):
            with free:
                on_devices.submit(step, options, number, device, *more).result()
            bench.path(None, done).touch()
        print(f"robot {number}: {done}, {time.perf_counter() - began:.0f} s", flush=True)

    def diagnose(row: Callable[..., None], pairs: Sequence[tuple[int, str]]) -> None:
        for repeated in (False, True)[: 1 + options.again]:
            for arm in sorted({arm for _, arm in pairs}) if repeated else ():
                on_device(simulate_found, f"again_{arm}", arm)
            todo = [pair for pair in pairs if missing(pair[0], f"{pair[1]}_row.json")]
            wait([jobs.submit(row, options, number, *pair) for pair in todo])

    on_device(first_swims, "swum_1")
    if missing(None, "prior.npz"):
        jobs.submit(learn, options, number).result()
    cases = bench.complete("first.csv", "usual.csv")
    diagnose(first_row, [(k, "first") for k in cases])
    on_device(designed_swims, "swum_2")
    cases = [k for k in cases if not missing(k, "designed.csv")]
    diagnose(second_row, [(k, arm) for k in cases for arm in ARMS])
    return f"robot {number}: {len(cases)} cases, {time.perf_counter() - began:.0f} s"


def wait(futures: Sequence[Future[None]]) -> None:
    """Wait for jobs; what failed is printed, and left out."""
    for future in as_completed(futures):
        if future.exception():
            print(repr(future.exception()), flush=True)


def draw(options: Options, robots: int, hashes: Path) -> None:
    """Write the seed and the answers of a sealed set, and the hashes of both and of the code."""
    options.out.mkdir(parents=True, exist_ok=True)
    benches = [bench_of(options, number) for number in range(robots)]
    answers = [
        [{"kind": case.kind, "effects": case.effects} for case in bench.cases] for bench in benches
    ]
    sealed = json.dumps({"seed": options.seed, "robots": answers}, indent=1) + "\n"
    (options.out / "answers.json").write_text(sealed)
    code = sorted([*POOL.glob("*.py"), *Path(__file__).parent.glob("design_swims*.py")])
    hashed = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in code}
    write_json(hashes, {"answers.json": hashlib.sha256(sealed.encode()).hexdigest()} | hashed)


def main() -> None:
    """Swim, diagnose, design, swim, diagnose; or draw a set, or report it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--cases", type=int, default=16, help="of a robot")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--device", default="cpu", help="one or several, with commas between")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a swim")
    parser.add_argument("--cell-m", type=float, default=0.014)
    parser.add_argument("--seed", type=int, default=40_003)
    parser.add_argument("--water", action="store_true")
    parser.add_argument("--water-cell-m", type=float, default=CELL_M)
    parser.add_argument("--again", action="store_true", help="with the effects that were found")
    parser.add_argument("--drawn", type=int, default=96, help="random swims of a design")
    parser.add_argument("--rounds", type=int, default=4, help="of variations of the best")
    parser.add_argument("--draw", type=Path, metavar="HASHES", help="a sealed set, and stop")
    parser.add_argument("--report", type=Path, metavar="JSON", help="of what is there, and stop")
    parser.add_argument("--decisions", action="store_true", help="fit odds to it, and stop")
    given = parser.parse_args()
    kept = given.out / "answers.json"
    seed = json.loads(kept.read_text())["seed"] if kept.exists() else given.seed
    options = Options(
        given.out, secrets.randbits(63) if given.draw else seed, given.cases, given.seconds,
        given.cell_m, given.water, given.water_cell_m, given.again,
        {"drawn": given.drawn, "rounds": given.rounds},
    )  # fmt: skip
    if given.draw:
        draw(options, given.robots, given.draw)
        return
    benches = [bench_of(options, number) for number in range(given.robots)]
    if given.report:
        report(benches, given.report, options.seed)
    if given.decisions:
        target = IN_WATER if given.water else FILE
        choose(decision_cases(benches), target, given.processes, go_on=True)
    if given.report or given.decisions:
        return
    devices = given.device.split(",")
    free = [Semaphore(AT_ONCE) for _ in devices]
    spawn = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(given.processes, mp_context=spawn) as jobs,
        ProcessPoolExecutor(AT_ONCE * len(devices), mp_context=spawn) as on_devices,
        ThreadPoolExecutor(given.robots) as robots,
    ):
        running = []
        for n in range(given.robots):
            k = n % len(devices)
            running.append(
                robots.submit(run_robot, options, n, devices[k], jobs, on_devices, free[k])
            )
        for robot in as_completed(running):
            print(repr(robot.exception() or robot.result()), flush=True)


if __name__ == "__main__":
    main()
