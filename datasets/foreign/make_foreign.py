"""Make cases of servos: of MuJoCo, by the circuit, two gear trains, and our own.

Needs ``pip install mujoco numba``. Run ``python datasets/foreign/make_foreign.py --help``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import secrets
import sys
from collections.abc import Collection, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "concealed"))

import numpy as np
from bus_answer import bus_answer
from files import answer, hashes, write_case
from foreign_cases import BACKLASH_WITH_FRICTION, CAN, OUTSIDE, draw_case, nuisances
from foreign_servos import HOBBY, PLANTS
from knower import consult
from tqdm import tqdm

TRAPS = ("wrong_parameters", "clock")
TRAP_SHARE = 0.2
TIER = "T1'"
Row = dict[str, Any]


def singles(plant: str) -> tuple[str, ...]:
    """What a single case of a plant can be."""
    return (*CAN[plant], *BACKLASH_WITH_FRICTION[plant])


def plan(
    counts: Row,
    rng: np.random.Generator,
    plants: Sequence[str] = PLANTS,
    effects: Sequence[str] = (),
) -> list[tuple[str, str, str]]:
    """Plant, kind and name of every case, in random order.

    Plants take turns, and so do the effects of each. With ``effects`` the single cases are of these
    only: they take turns, and so do the plants that have each.
    """
    cases = []
    for kind, count in counts.items():
        if kind == "single" and effects:
            cases += _of_effects(count, plants, effects, rng)
            continue
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


def _of_effects(
    count: int, plants: Sequence[str], effects: Sequence[str], rng: np.random.Generator
) -> list[tuple[str, str, str]]:
    """Plant, kind and name of single cases of some effects."""
    turns = []
    for name in rng.permutation(effects):
        able = [plant for plant in plants if name in singles(plant)]
        cases = [(str(plant), "single", str(name)) for plant in rng.permutation(able)]
        turns.append(itertools.cycle(cases))
    return [next(turn) for turn in itertools.islice(itertools.cycle(turns), count)]


def make(job: tuple[Path, int, int, tuple[str, str, str], bool]) -> Row:
    """One case written, and its answer."""
    out, seed, k, (plant, kind, name), oracle = job
    case = draw_case(plant, kind, name, np.random.default_rng([seed, k]))
    label = f"case_{k + 1:04d}"
    write_case(case, label, out)
    more: Row = {"plant": plant, "nuisances": nuisances(case), "seed": [seed, k]}
    more["tier"] = TIER
    more["drawn"] = [plant, kind, name]
    more["bus"] = bus_answer(case)
    more["servos"] = [
        {"loop_Hz": s.loop_Hz, "eccentric": s.eccentric, "stall_Nm": s.stall_Nm,
         "no_load_speed_rad_s": s.no_load_speed_rad_s, "kp": s.kp, "noise_rad": s.noise_rad,
         "firmware_damping": s.firmware_damping, "stated": s.stated,
         "rotor_inertia": s.rotor_inertia, "friction_on_output": s.friction_on_output,
         "sensor_on_output": s.sensor_on_output, "dry_friction_Nm": s.dry_friction_Nm,
         "current_limited": s.current_limited, "control_on_output": s.control_on_output,
         "flank": s.flank}
        for s in case.servos
    ]  # fmt: skip
    return {**answer(case, label), **more, "oracle": consult(case) if oracle else {}}


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


def _names(
    arguments: Sequence[str], known: Collection[str], parser: argparse.ArgumentParser
) -> list[str]:
    """Names separated by blanks or commas; ends with a message if one is unknown."""
    names = [name for argument in arguments for name in argument.split(",") if name]
    for name in names:
        if name not in known:
            parser.error(f"{name!r} is not one of {', '.join(known)}")
    return names


def main(arguments: Sequence[str] | None = None) -> None:
    """Write inputs, held-out recordings, answers and hashes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--seed", type=int, help="default: drawn and kept in the answers")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    for kind, count in (("null", 210), ("single", 270), ("double", 72), ("outside", 60)):
        parser.add_argument(
            f"--{kind}", type=int, default=count, metavar="N", help=f"default: {count}"
        )
    parser.add_argument(
        "--plants",
        nargs="+",
        default=PLANTS,
        metavar="PLANT",
        help=f"plants that take turns, separated by blanks or commas: {HOBBY}, and by default"
        f" {' '.join(PLANTS)}",
    )
    parser.add_argument(
        "--effects",
        nargs="+",
        default=(),
        metavar="EFFECT",
        help="effects of the single cases, in equal numbers, each by the plants that have it;"
        " default: all effects of the catalogue that a plant has. backlash_motor_friction and"
        " backlash_output_friction are backlashes of servos with dry friction on one side;"
        " of backlash_rattling, of the hobby plant, neither friction nor weight holds the output",
    )
    parser.add_argument("--no-oracle", action="store_true", help="leave out what a knower can tell")
    parser.add_argument("--consult", action="store_true", help="of a set that is there: only that")
    options = parser.parse_args(arguments)
    if options.consult:
        consult_all(options.out, options.processes)
        return
    plants = _names(options.plants, (*PLANTS, HOBBY), parser)
    known = dict.fromkeys(name for plant in plants for name in singles(plant))
    effects = _names(options.effects, known, parser)
    if options.out.exists() and any(options.out.iterdir()):
        parser.error(f"{options.out} is not empty")
    seed = secrets.randbits(63) if options.seed is None else options.seed
    counts = {kind: getattr(options, kind) for kind in ("null", "single", "double", "outside")}
    cases = plan(counts, np.random.default_rng(seed), plants, effects)
    jobs = [(options.out, seed, k, case, not options.no_oracle) for k, case in enumerate(cases)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
        answers = list(tqdm(pool.map(make, jobs), total=len(jobs), disable=None))
    (options.out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    (options.out / "hashes.json").write_text(json.dumps(hashes(options.out), indent=1) + "\n")


if __name__ == "__main__":
    main()
