"""Designs by CasADi and IPOPT against the search, at equal processor time and on the same score.

The command is a cubic B-spline; angles and their exact derivatives are those of Runge-Kutta steps
between samples (direct single shooting), and IPOPT maximises the mean logarithm of the determinant
of the information with limits on the coefficients, within which the spline then stays.

    python benchmarks/design_ipopt.py --servos 6 --seconds 60
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

from sim2real.arrays import Array
from sim2real.design.belief import Belief, belief_of
from sim2real.design.information import Information
from sim2real.design.limits import CommandLimits, limits_of, within
from sim2real.design.search import best
from sim2real.output import write_json
from sim2real.recording import Load
from sim2real.robot import Joint, Link, Robot, Servo

SECONDS = 30.0


def interval(step_s: float, substeps: int, names: tuple[str, ...]) -> ca.Function:
    """State (q, v) and its derivatives by logarithms over one sample, by Runge-Kutta steps.

    Inputs: state with derivatives (2 + 2 F), set-points and their rates at the stages, and the
    parameters kp, kd, latency, inertia, gravity, stall torque, no-load speed.
    """
    F, stages = len(names), 2 * substeps + 1
    x, by = ca.SX.sym("x", 2), ca.SX.sym("by", 2, F)
    u, rate, p = ca.SX.sym("u", stages), ca.SX.sym("rate", stages), ca.SX.sym("p", 7)
    kp, kd, latency, inertia, gravity, stall, speed = ca.vertsplit(p)

    def slope(x: ca.SX, u: ca.SX) -> ca.SX:
        line = stall / speed
        drive = kp * (u - x[0]) - (kd - line) * x[1]
        clipped = ca.fmax(ca.fmin(drive, stall), -stall)
        return ca.vertcat(x[1], (clipped - line * x[1] - gravity * ca.sin(x[0])) / inertia)

    after, h = x, step_s / substeps
    for k in range(substeps):
        a, b, c = u[2 * k], u[2 * k + 1], u[2 * k + 2]
        k1 = slope(after, a)
        k2 = slope(after + h / 2 * k1, b)
        k3 = slope(after + h / 2 * k2, b)
        k4 = slope(after + h * k3, c)
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    direct = ca.jacobian(after, p)[:, [0, 1, 2, 5, 6][:F]] @ ca.diag(p[[0, 1, 2, 5, 6][:F]])
    late = -ca.jacobian(after, u) @ rate * latency
    direct[:, 2] = late
    out = ca.vertcat(after, ca.vec(ca.jacobian(after, x) @ by + direct))
    state = ca.vertcat(x, ca.vec(by))
    return ca.Function("interval", [state, ca.vertcat(u, rate), p], [ca.cse(out)])


def spline_design(
    belief: Belief,
    limits: CommandLimits,
    start: Array,
    *,
    seconds: float,
    spacing_s: float,
    substeps: int = 4,
) -> tuple[Array, int]:
    """The command (T,) that IPOPT reaches from another in some seconds, and its iterations."""
    t = limits.times(SECONDS)
    F, D = len(belief.names), len(belief.rows)
    inner = np.arange(limits.rest_s, SECONDS - limits.rest_s + 1e-9, spacing_s)
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    n = knots.size - 4
    moving = slice(3, n - 3)  # at rest at both ends

    def basis(times: Array, order: int = 0) -> Array:
        columns = np.zeros((times.size, n))
        inside = (times >= knots[0]) & (times < knots[-1])
        whole = BSpline(knots, np.eye(n), 3)
        columns[inside] = (whole.derivative(order) if order else whole)(times[inside])
        return columns[:, moving]

    c = ca.MX.sym("c", basis(t).shape[1])
    value = ca.MX(0)
    run = interval(limits.period_s, substeps, belief.names).mapaccum(t.size)
    fraction = np.arange(2 * substeps + 1) / (2 * substeps) * limits.period_s
    prior = np.diag(1 / belief.prior_sd**2)
    for row in belief.rows:
        times = (t[:, None] + fraction - row[2]).ravel()
        shape = (2 * substeps + 1, t.size)
        u, rate = (
            ca.reshape(ca.DM(ca.sparsify(ca.DM(basis(times, k)))) @ c, *shape) for k in (0, 1)
        )
        p = np.array([row[0], row[1], row[2], row[3], row[4], row[5], row[6]])
        states = run(np.zeros(2 + 2 * F), ca.vertcat(u, rate), ca.repmat(ca.DM(p), 1, t.size))
        slopes = states[2::2, :]
        information = slopes @ slopes.T / belief.noise.white_rad**2 + prior
        value += ca.log(ca.det(information)) / D
    half = limits.reach_rad
    rates = ca.diff(ca.vertcat(0, 0, 0, c, 0, 0, 0)) / spacing_s
    problem = {"x": c, "f": -value, "g": rates}
    options = {
        "ipopt": {
            "hessian_approximation": "limited-memory", "print_level": 0, "sb": "yes",
            "max_cpu_time": seconds, "limited_memory_max_history": 20,
        },
        "print_time": False,
    }  # fmt: skip
    solver = ca.nlpsol("design", "ipopt", problem, options)
    first = np.clip(np.linalg.lstsq(basis(t), start - limits.rest_rad, rcond=None)[0], -half, half)
    found = solver(
        x0=0.9 * first, lbx=-half, ubx=half, lbg=-limits.rate_rad_s, ubg=limits.rate_rad_s
    )
    iterations = int(solver.stats()["iter_count"])
    command = limits.rest_rad + basis(t) @ np.asarray(found["x"]).ravel()
    return within(command[None], limits)[0], iterations


def one(k: int, seconds: float, draws: int) -> dict[str, Any]:
    """Both on the same servo."""
    rng = np.random.default_rng(k)
    link = Link("link")
    stall = float(np.exp(rng.uniform(np.log(1.0), np.log(5.0))))
    speed = float(np.exp(rng.uniform(np.log(5.0), np.log(20.0))))
    joint = Joint("j1", Servo("servo", stall, speed, 0.00153), (-0.8, 0.8))
    robot = Robot("bench", (link, link), (joint,))
    limits = limits_of(robot)
    load = Load(float(np.exp(rng.uniform(np.log(0.001), np.log(0.008)))))
    belief = belief_of(robot, None, limits, load=load, draws=draws, seed=k)
    objective = Information(belief, limits)
    objective(np.zeros((1, 100)))  # loads the kernels
    row: dict[str, Any] = {}
    begin = time.process_time()
    found = best(objective, limits, SECONDS, rng=rng)
    row["search"] = {"score": found.score, "cpu_s": time.process_time() - begin}
    rough = best(objective, limits, SECONDS, rng=rng, drawn=32, rounds=0)
    for spacing in (0.1, 0.25):
        begin = time.process_time()
        command, iterations = spline_design(
            belief, limits, rough.command, seconds=seconds, spacing_s=spacing
        )
        row[f"ipopt {spacing:g} s"] = {
            "score": float(objective(command[None])[0]),
            "cpu_s": time.process_time() - begin,
            "iterations": iterations,
        }
    row["start of ipopt"] = {"score": rough.score}
    return row


def main() -> None:
    """Print and write the scores."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--servos", type=int, default=6, metavar="N")
    parser.add_argument("--draws", type=int, default=8, help="servos of the belief")
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time of IPOPT")
    parser.add_argument("--out", type=Path, default=Path("reports/design"), metavar="DIR")
    options = parser.parse_args()
    rows = [one(k, options.seconds, options.draws) for k in range(options.servos)]
    for row in rows:
        print("; ".join(f"{n}: " + ", ".join(f"{a} {b:.3g}" for a, b in v.items())
                        for n, v in row.items()))  # fmt: skip
    write_json(options.out / "ipopt.json", {"servos": rows})


if __name__ == "__main__":
    main()
