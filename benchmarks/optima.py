"""Does one verb find an optimum that another verb misses, on the same recordings?

    python -m benchmarks.optima --cases 34 --seed 5 --out build/optima.jsonl

Servos are those of ``benchmarks.coverage``. For each, the models of ``identify`` and ``diagnose``,
the optimum of ``posterior`` and the best of a search from draws of the prior are compared by the
log-posterior that ``posterior`` samples, with the noise of its own optimum. A model of a diagnosis
counts where it has the same parameters, that is where no effect was added.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.coverage import PLANTS
from benchmarks.harness import command_line, kept, read_lines, spread, table
from sim2real.arrays import Array
from sim2real.diagnose.diagnose import diagnose
from sim2real.identification.identify import identify
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import fit
from sim2real.inference.parameters import column
from sim2real.model import JointModel
from sim2real.posterior.servo import servo_problem
from sim2real.robot import Joint, Link, Robot
from sim2real.servo.trace import traces

MOST_NATS = 2.0
"""Difference of log-posteriors from which an optimum is beaten."""
Row = dict[str, Any]


def compared(job: tuple[str, int, int], *, draws: int) -> Row:
    """Log-posteriors of a servo's models, less that of the best."""
    plant, *seeds = job
    rng = np.random.default_rng(seeds)
    recordings, servo, _ = PLANTS[plant](rng)
    link, joint = Link("link", 1.0, 0.1, 0.1, 0.1), Joint("j1", servo, (-2.0, 2.0))
    robot = Robot("bench", (link, link), (joint,))
    seen = traces(recordings, "j1")
    model = identify(recordings, robot).joints["j1"]
    problem = servo_problem(seen, model, servo)
    best = fit(problem, problem.row[None])
    wide = fit(problem, np.vstack([best.row, problem.rows(drawn(problem, draws, rng))]))
    rows = {"identify": problem.row, "posterior": best.row, "search": wide.row}
    other = diagnose(recordings, robot).model.joints["j1"]
    if same_parameters(model, other):
        rows["diagnose"] = servo_problem(seen, other, servo).row
    x = problem.searched(np.array(list(rows.values())))
    noise = best.scale_rad, best.inflation
    value = -0.5 * problem.loss(x, problem.residuals(x), *noise)
    behind = (value.max() - value).tolist()
    return {"job": job, "behind": dict(zip(rows, behind, strict=True))}


def same_parameters(one: JointModel, other: JointModel) -> bool:
    """Whether two models of a joint differ in values alone."""
    effects = [sorted(e.effect for e in joint.effects) for joint in (one, other)]
    return one.law == other.law and set(one.motor) == set(other.motor) and effects[0] == effects[1]


def drawn(problem: ServoProblem, count: int, rng: np.random.Generator) -> Array:
    """Points of the prior, at most two natural units from its centre, shape (count, F)."""
    centre = problem.searched(problem.row[None])[0]
    sd = np.minimum(column(problem.parameters, "prior_sd") / problem.unit, 2 * problem.natural)
    x: Array = centre + sd * rng.standard_normal((count, sd.size))
    return np.clip(x, *problem.box)


def rows_of(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Of each plant and verb: how many optima are beaten, and by how much."""
    for plant in PLANTS:
        mine = [row["behind"] for row in rows if row["job"][0] == plant]
        for verb in ("identify", "diagnose", "posterior", "search"):
            behind = np.array([row[verb] for row in mine if verb in row])
            beaten = int(np.sum(behind > MOST_NATS))
            at = np.quantile(behind, (0.5, 0.9, 1.0)) if behind.size else np.zeros(3)
            yield [plant, verb, f"{beaten} of {behind.size}", *(f"{value:.2f}" for value in at)]


def main() -> None:
    """Fit, compare, print the table."""
    options = command_line(
        __doc__, cases=(34, "servos of each plant"), seed=5, processes=2, out=Path,
        draws=(12, "starts of the wide search"),
    ).parse_args()  # fmt: skip
    jobs = [(plant, options.seed, case) for case in range(options.cases) for plant in PLANTS]
    rows = read_lines(options.out) if options.out else []
    left = [job for job in jobs if list(job) not in [row["job"] for row in rows]]
    found = spread(partial(compared, draws=options.draws), left, options.processes, in_order=False)
    rows += kept(options.out, found) if options.out else found
    beaten = f"beaten by {MOST_NATS:g} nats"
    print(table(("plant", "verb", beaten, "median", "90 %", "largest"), rows_of(rows)))


if __name__ == "__main__":
    main()
