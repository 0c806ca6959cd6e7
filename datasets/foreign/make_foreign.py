"""Make cases of servos of four plants: MuJoCo, by the circuit, a gear train, and our own.

Needs ``pip install mujoco numba``. Run ``python datasets/foreign/make_foreign.py --help``.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import secrets
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "concealed"))

import numpy as np
from files import answer, hashes, write_case
from foreign_cases import CAN, OUTSIDE, draw_case, nuisances
from foreign_servos import PLANTS
from knower import consult
from tqdm import tqdm

TRAPS = ("wrong_parameters", "clock")
TRAP_SHARE = 0.2
TIER = "T1'"
Row = dict[str, Any]


def plan(
    counts: Row, rng: np.random.Generator, plants: Sequence[str] = PLANTS
) -> list[tuple[str, str, str]]:
    """Plant, kind and name of every case, in random order; plants and effects in turn."""
    cases = []
    for kind, count in counts.items():
        names = {}
        for plant in plants:
            of = {"single": CAN[plant], "outside": OUTSIDE[plant]}.get(kind, ("",))
            names[plant] = [str(n) for n in rng.permutation(list(of))]
        for k in range(count):
            plant, turn = plants[k % len(plants)], k // len(plants)
            name, what = names[plant][turn % len(names[plant])], kind
            if kind == "null" and turn % round(1 / TRAP_SHARE) == 0:
                what, name = "trap", TRAPS[turn // round(1 / TRAP_SHARE) % len(TRAPS)]
            cases.append((plant, what, name))
    return [cases[i] for i in rng.permutation(len(cases))]


def make(job: tuple[Path, int, int, tuple[str, str, str], bool]) -> Row:
    """One case written, and its answer."""
    out, seed, k, (plant, kind, name), oracle = job
    case = draw_case(plant, kind, name, np.random.default_rng([seed, k]))
    label = f"case_{k + 1:04d}"
    write_case(case, label, out)
    rest: Row = {"plant": plant, "nuisances": nuisances(case), "seed": [seed, k]}
    rest["tier"] = TIER
    rest["drawn"] = [plant, kind, name]
    rest["servos"] = [
        {"loop_Hz": s.loop_Hz, "eccentric": s.eccentric, "stall_Nm": s.stall_Nm,
         "no_load_speed_rad_s": s.no_load_speed_rad_s, "kp": s.kp, "noise_rad": s.noise_rad,
         "firmware_damping": s.firmware_damping, "stated": s.stated,
         "rotor_inertia": s.rotor_inertia, "friction_on_output": s.friction_on_output,
         "sensor_on_output": s.sensor_on_output}
        for s in case.servos
    ]  # fmt: skip
    return {**answer(case, label), **rest, "oracle": consult(case) if oracle else {}}


def told(answer: Row) -> tuple[str, Row]:
    """What a knower can tell of a case that was made before."""
    case = draw_case(*answer["drawn"], np.random.default_rng(answer["seed"]))
    return answer["case"], consult(case)


def consult_all(out: Path, processes: int) -> None:
    """Write ``oracle.json`` beside the answers, which stay as they were published."""
    answers = json.loads((out / "answers.json").read_text())
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool:
        found = dict(tqdm(pool.map(told, answers), total=len(answers), disable=None))
    (out / "oracle.json").write_text(json.dumps(found, indent=1) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write inputs, held-out recordings, answers and hashes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--seed", type=int, help="default: drawn and kept in the answers")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    for kind, count in (("null", 210), ("single", 270), ("double", 72), ("outside", 60)):
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N")
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=PLANTS, metavar="PLANT")
    parser.add_argument("--no-oracle", action="store_true", help="leave out what a knower can tell")
    parser.add_argument("--consult", action="store_true", help="of a set that is there: only that")
    options = parser.parse_args(arguments)
    if options.consult:
        consult_all(options.out, options.processes)
        return
    if options.out.exists() and any(options.out.iterdir()):
        parser.error(f"{options.out} is not empty")
    seed = secrets.randbits(63) if options.seed is None else options.seed
    counts = {kind: getattr(options, kind) for kind in ("null", "single", "double", "outside")}
    cases = plan(counts, np.random.default_rng(seed), options.plants)
    jobs = [(options.out, seed, k, case, not options.no_oracle) for k, case in enumerate(cases)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
        answers = list(tqdm(pool.map(make, jobs), total=len(jobs), disable=None))
    (options.out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    (options.out / "hashes.json").write_text(json.dumps(hashes(options.out), indent=1) + "\n")


if __name__ == "__main__":
    main()
