"""Make the sealed challenge "find the missing physics in a servo's recordings".

Needs ``pip install numba``. Run ``python datasets/concealed/make.py --help`` for the options.
"""

from __future__ import annotations

import argparse
import json
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cases import draw_case
from catalogue import EFFECTS
from files import answer, hashes, write_case
from oracle import consult
from outside import OUTSIDERS
from tqdm import tqdm

TRAPS = ("wrong_parameters", "clock")
TRAP_SHARE = 0.2  # of the nulls


def plan(null: int, single: int, double: int, outside: int, rng: np.random.Generator) -> list[Any]:
    """Kind and name of every case, in random order; effects in turn, so that each has its share."""
    traps = int(np.ceil(TRAP_SHARE * null))
    effects = [str(n) for n in rng.permutation(list(EFFECTS))]
    outsiders = [str(n) for n in rng.permutation(list(OUTSIDERS))]
    cases = [("null", "")] * (null - traps)
    cases += [("trap", TRAPS[i % len(TRAPS)]) for i in range(traps)]
    cases += [("single", effects[i % len(effects)]) for i in range(single)]
    cases += [("double", "")] * double
    cases += [("outside", outsiders[i % len(outsiders)]) for i in range(outside)]
    return [cases[i] for i in rng.permutation(len(cases))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write inputs, held-out recordings, answers and hashes."""
    parser = argparse.ArgumentParser(description="Make a sealed challenge.")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--seed", type=int, help="default: drawn and kept in the answers")
    for kind, count in (("null", 300), ("single", 400), ("double", 150), ("outside", 100)):
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N")
    parser.add_argument("--no-oracle", action="store_true", help="leave out what a knower can tell")
    parser.add_argument("--groups", action="store_true", help="also which effects look alike; slow")
    options = parser.parse_args(arguments)
    if options.out.exists() and any(options.out.iterdir()):
        parser.error(f"{options.out} is not empty")
    seed = secrets.randbits(64) if options.seed is None else options.seed
    order, *streams = np.random.SeedSequence(seed).spawn(
        1 + options.null + options.single + options.double + options.outside
    )
    counts = (options.null, options.single, options.double, options.outside)
    cases = plan(*counts, np.random.default_rng(order))
    answers = []
    for k, (kind, name) in enumerate(tqdm(cases, disable=None)):
        case, scales = draw_case(kind, name, np.random.default_rng(streams[k]))
        label = f"case_{k + 1:04d}"
        write_case(case, label, options.out)
        oracle = {} if options.no_oracle else consult(case, scales, groups=options.groups)
        answers.append({**answer(case, label), "oracle": oracle, "seed": seed})
    (options.out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    (options.out / "hashes.json").write_text(json.dumps(hashes(options.out), indent=1) + "\n")


if __name__ == "__main__":
    main()
