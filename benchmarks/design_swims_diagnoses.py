"""Diagnoses and designs of ``design_swims.py``, one case each."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.design_swims_cases import Bench, Options, bench_of
from sim.design.design_swim import design_swim
from sim.inference.coordinates import SwimSimulator
from sim.inference.diagnose_swims import diagnosis_of, likely_model
from sim.inference.in_water import (
    by_twin_in_water,
    read_water_swims,
    robot_in_water,
    with_fluid_effects,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import FILE, IN_WATER, LawError, read_law_error
from sim.inference.searched import learned, raw, searched
from sim.inference.swim_decision import decide
from sim.inference.twin_search import SwimPrior
from sim2real.body import values
from sim2real.diagnose.result import Diagnosis
from sim2real.diagnose.separation import separations
from sim2real.model import Model, read_model, write_model
from sim2real.structured import Fields

WATERS = "water_*.npz"
"""Files of simulations in the fluid, of a robot."""


def learn(options: Options, number: int) -> None:
    """The prior that a robot's reference swims give."""
    bench = bench_of(options, number)
    if options.water:
        file = bench.path(None, "water_1.npz")
        water = read_water_swims(file)
        write_water(file, with_nearest_law(bench.drawn.robot, bench.model, water, threads=1))
    references = [bench.read(bench.path(None, f"reference_{n}.csv")) for n in range(2)]
    model, simulate, law_error = start_of_diagnosis(options, bench)
    prior = learned(references, model, bench.drawn.robot, simulate, law_error)
    np.savez(bench.path(None, "prior.npz"), **vars(prior))


def start_of_diagnosis(options: Options, bench: Bench) -> tuple[Model, SwimSimulator, LawError]:
    """The model, the simulator and its error, from which a robot's diagnoses start."""
    law_error = read_law_error(IN_WATER if options.water else FILE)
    files = sorted(bench.folder.glob(WATERS))
    return *robot_in_water(bench.drawn.robot, bench.model, files, threads=1), law_error


def swims_of(bench: Bench, k: int, arm: str) -> list[Path]:
    """Recordings of a case that the diagnosis of an arm reads."""
    return [bench.path(k, f"{name}.csv") for name in dict.fromkeys(("first", arm))]


def diagnosed(
    options: Options, bench: Bench, k: int, arm: str
) -> tuple[dict[str, Any], Diagnosis] | None:
    """The diagnosis of the swims of an arm, with references, and what the report needs of it.

    With ``--again``: None after the first of two, if the fluid has to simulate what was found.
    """
    model, simulate, law_error = start_of_diagnosis(options, bench)
    kept = np.load(bench.path(None, "prior.npz"))
    prior = SwimPrior(**{name: kept[name] for name in kept.files})
    robot, model_found, simulated = bench.drawn.robot, bench.path(k, f"{arm}_found.json"), None
    if model_found.exists():
        simulated = read_model(model_found)
        water = read_water_swims(bench.path(None, f"again_{arm}.npz"))
        simulate = by_twin_in_water(robot, simulated, water, threads=1)
    start = time.process_time()
    swims = [bench.read(path) for path in swims_of(bench, k, arm)]
    found = searched(swims, model, robot, simulate, prior, simulated=simulated)
    if options.again and simulated is None:
        with_effects = with_fluid_effects(model, likely_model(found, law_error, referred=True))
        if values(with_effects):
            write_model(with_effects, model_found)
            return None
    tried = raw(found, referred=True)
    decided = decide(tried, law_error.decisions)
    diagnosis = diagnosis_of(found, robot, law_error, referred=True)
    sets = sorted(
        ([[list(name) for name in sorted(s)], x] for s, x in decided.sets.items()),
        key=lambda one: -one[1],
    )
    return {
        "verdict": diagnosis.verdict,
        "named": [{"group": one.group, "probability": one.probability} for one in decided.named],
        "sets": sets[:12], "raw": tried, "cpu_s": time.process_time() - start,
    }, diagnosis  # fmt: skip


def first_row(options: Options, number: int, k: int, arm: str = "first") -> None:
    """Diagnose the first swim of a case, design the second, and keep both."""
    bench = bench_of(options, number)
    case = bench.cases[k]
    result = diagnosed(options, bench, k, arm)
    if result is None:
        return
    row, first = result
    assert first.swim_rivals is not None
    start = time.process_time()
    design = design_swim(
        first.swim_rivals, first.model, bench.drawn.robot,
        seconds=options.seconds, again=True, seed=number, threads=1, **options.search,
    )  # fmt: skip
    (body,) = design.joints
    np.save(bench.path(k, "command.npy"), body.command)
    content = {
        "case": f"{number}.{k}", "kind": case.kind, "effects": case.effects,
        "strength": case.strength, "first": row, "stated": body.content(),
        "design_cpu_s": time.process_time() - start,
    }  # fmt: skip
    bench.path(k, "first_row.json").write_text(json.dumps(content) + "\n")


def second_row(options: Options, number: int, k: int, arm: str) -> None:
    """Diagnose both swims of a case, with the second swim of an arm."""
    bench = bench_of(options, number)
    result = diagnosed(options, bench, k, arm)
    if result is None:
        return
    row, both = result
    assert both.swim_rivals is not None
    found = {frozenset(one.effects): one.probability for one in both.swim_rivals.sets}
    stated = json.loads(bench.path(k, "first_row.json").read_text())["stated"]
    told = separations("body", [Fields("design", "", stated)], found)
    row["told"] = [vars(one) for one in told]
    bench.path(k, f"{arm}_row.json").write_text(json.dumps(row) + "\n")
