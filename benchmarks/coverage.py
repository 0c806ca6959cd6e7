"""Do the intervals of a servo's parameters hold what they promise, and how large are the errors?

    python -m benchmarks.coverage --cases 200 --seed 1              # identify
    python -m benchmarks.coverage --cases 400 --seed 20 --posterior [--out ranks.json]

Simulated servos are sent 30 s of random steps at 50 Hz with jittered times; their motion is a sum
of closed-form step responses, which share no code with the library. For ``identify`` gains (natural
frequency 10 to 60 rad/s, damping ratio 0.3 to 1.2) and latency (20 to 120 ms) are read with 1.5
mrad of noise in steps of 0.24 degrees. For the posterior they are drawn from the prior that is
sampled under, the noise is correlated in time, and how much is not told to the sampler; the rank of
the truth among the draws is then uniform: Talts, Betancourt, Simpson, Vehtari, Gelman, Validating
Bayesian inference algorithms with simulation-based calibration, arXiv:1804.06788 (2018).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.stats import binom

from benchmarks.harness import command_line, spread, table
from sim2real.arrays import Array
from sim2real.identification.identify import identify
from sim2real.inference.parameters import Parameter
from sim2real.output import write_json
from sim2real.posterior.servo import sample_servo
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.trace import trace

INERTIA = 0.002
DRAWN = (
    Parameter("kp_Nm_per_rad", 0.6, 6.0, 2.0, log=True),
    Parameter("kd_Nms_per_rad", 0.02, 0.2, 0.06, log=True),
    Parameter("latency_s", 0.02, 0.12, 0.05),
)
NAMES = [p.name for p in DRAWN]
LEVELS = (0.5, 0.8, 0.95)
NOISE_RAD, WANDER_RAD, STEP_RAD = 0.0015, 0.0015, np.deg2rad(0.24)
WANDER_S = (0.05, 1.0)
STEPS = (800, 4000, 20000)
"""Of the chain: longer where it is too short to be published."""
DRAWS = 199
TITLES = ("kp", "kd", "latency")


def bench(servo: Servo) -> Robot:
    """A robot of one joint."""
    link = Link("link", 1.0, 0.1, 0.1, 0.1)
    return Robot("bench", (link, link), (Joint("j1", servo, (-1.0, 1.0)),))


def recorded(t: Array, command: Array, position: Array) -> Recording:
    """A recording of the joint."""
    load = {"j1": Load(INERTIA)}
    return Recording("steps", "servo", ("j1",), t, command[:, None], position[:, None], load)


def answered(t: Array, command: Array, kp: float, kd: float, latency: float) -> Array:
    """Angles (T,) of a PD servo on an inertia: the sum of its answers to every step of command."""
    angle = np.full(t.size, command[0])
    for k in 1 + np.flatnonzero(np.diff(command)):
        late = t - t[k] - latency
        after = late > 0
        angle[after] += (command[k] - command[k - 1]) * unit_step(late[after], kp, kd)
    return angle


def unit_step(t: Array, kp: float, kd: float) -> Array:
    """Step response by partial fractions over the two poles of I s2 + kd s + kp."""
    root = np.sqrt(complex(kd**2 - 4 * INERTIA * kp))
    p, q = (-kd + root) / (2 * INERTIA), (-kd - root) / (2 * INERTIA)
    return np.asarray((1 + (q * np.exp(p * t) - p * np.exp(q * t)) / (p - q)).real)


def wander(t: Array, sd: float, time_s: float, rng: np.random.Generator) -> Array:
    """Ornstein-Uhlenbeck noise (T,) of a standard deviation and correlation time."""
    x, value = np.empty(t.size), sd * rng.standard_normal()
    for k in range(t.size):
        if k:
            keep = math.exp(-(t[k] - t[k - 1]) / time_s)
            value = keep * value + sd * math.sqrt(1 - keep**2) * rng.standard_normal()
        x[k] = value
    return x


def recover(seed: int) -> tuple[Array, Array, Array]:
    """Truth, estimate and 90 % interval (3, 2) of one servo by ``identify``."""
    rng = np.random.default_rng(seed)
    frequency, damping = np.exp(rng.uniform(np.log(10), np.log(60))), rng.uniform(0.3, 1.2)
    kp, kd = frequency**2 * INERTIA, 2 * damping * frequency * INERTIA
    truth = np.array([kp, kd, rng.uniform(0.02, 0.12)])
    t = np.arange(0.0, 30.0, 0.02)
    t = t + rng.normal(0.0, 3e-4, t.size)
    changes = 0.5 + np.cumsum(rng.uniform(0.4, 1.5, 100))
    command = np.append(0.0, rng.uniform(-0.6, 0.6, 100))[np.searchsorted(changes, t)]
    noisy = answered(t, command, *truth) + rng.normal(0.0, NOISE_RAD, t.size)
    recording = recorded(t, command, np.round(noisy / STEP_RAD) * STEP_RAD)
    robot = bench(Servo("servo", 10.0, 100.0, STEP_RAD))
    model = identify([recording], robot).joints["j1"]
    estimate = np.array([getattr(model, name) for name in NAMES])
    return truth, estimate, np.array([model.interval[name] for name in NAMES])


def ranked(case: np.random.SeedSequence) -> tuple[list[int], bool]:
    """Ranks of the true parameters among draws of the posterior; whether the chain is long."""
    rng = np.random.default_rng(case)
    truth = np.exp(rng.uniform(*np.log([[p.low, p.high] for p in DRAWN]).T))
    t = np.arange(1500) / 50.0
    t = t + rng.uniform(-0.001, 0.001, t.size)
    edges = 0.5 + np.cumsum(rng.uniform(0.3, 0.9, 100))
    levels = np.concatenate([[0.0], rng.uniform(-0.6, 0.6, edges.size)])
    command = levels[np.searchsorted(edges, t, side="right")]
    noise = NOISE_RAD * rng.standard_normal(t.size)
    noise += wander(t, WANDER_RAD, math.exp(rng.uniform(*np.log(WANDER_S))), rng)
    recording = recorded(t, command, answered(t, command, *truth) + noise)
    model = identify([recording], bench(Servo("bench", 1.67, 5.24, 0.0)), law="pd").joints["j1"]
    given, seed = [trace(recording, "j1")], int(rng.integers(2**31))
    for steps in STEPS:
        found = sample_servo(given, model, seed=seed, steps=steps)
        if found.convergence.reached:
            break
    draws = found.values[rng.choice(found.values.shape[0], DRAWS, replace=False)]
    return [int(r) for r in (draws < truth).sum(axis=0)], found.convergence.reached


def covered(ranks: Array, level: float) -> Array:
    """Share of cases whose truth lies in the central interval of this level, shape (F,).

    A rank r of L draws is a quantile (r + 1/2) / (L + 1).
    """
    quantile = (ranks + 0.5) / (DRAWS + 1)
    return np.asarray((np.abs(quantile - 0.5) < level / 2).mean(axis=0))


def of_posterior(cases: int, seed: int, processes: int, out: Path | None) -> None:
    """Print the coverage of the posterior's central intervals; keep the ranks."""
    seeds = np.random.SeedSequence(seed).spawn(cases)
    found = [ranked(seeds[0])]  # alone: it compiles what the others load
    found += spread(ranked, seeds[1:], processes, unit="servo")
    ranks = np.array([one for one, _ in found])
    rows = []
    for level in LEVELS:
        low, high = (100 * binom.ppf(p, cases, level) / cases for p in (0.025, 0.975))
        shares = (f"{100 * x:.1f} %" for x in covered(ranks, level))
        rows.append((f"{100 * level:g} %", *shares, f"{low:.1f} to {high:.1f} %"))
    print(table(("central interval", *TITLES, "chance alone (95 %)"), rows))
    print(f"{sum(not long for _, long in found)} of {cases} chains are too short")
    if out:
        kept = {name: ranks[:, k].tolist() for k, name in enumerate(NAMES)}
        write_json(out, {"cases": cases, "seed": seed, "draws": DRAWS, "ranks": kept})


def of_identify(cases: int, seed: int, processes: int) -> None:
    """Print errors of ``identify`` and the coverage of its intervals."""
    seeds = range(1000 * seed, 1000 * seed + cases)
    results = list(spread(recover, seeds, processes, unit="servo"))
    truth, estimate, interval = (np.array(x) for x in zip(*results, strict=True))
    error = np.abs(estimate - truth)
    held = (interval[..., 0] <= truth) & (truth <= interval[..., 1])
    rows = []
    for k, name in enumerate(TITLES):
        late = name == "latency"
        size, unit = (1e3 * error[:, k], "ms") if late else (100 * error[:, k] / truth[:, k], "%")
        ends = (f"{x:.3f} {unit}" for x in (np.median(size), np.quantile(size, 0.95)))
        rows.append((name, *ends, f"{100 * held[:, k].mean():.1f} %"))
    print(f"{cases} servos, {INERTIA} kg m2, 30 s of steps (22.5 s of them fitted)")
    print(table(("", "median error", "95th percentile", "90 % interval holds"), rows))


def main() -> None:
    """Run the cases, print the table."""
    options = command_line(
        __doc__, cases=200, seed=1, processes=2, out=Path,
        posterior=(False, "of the posterior in place of identify"),
    ).parse_args()  # fmt: skip
    if options.posterior:
        of_posterior(options.cases, options.seed, options.processes, options.out)
    else:
        of_identify(options.cases, options.seed, options.processes)


if __name__ == "__main__":
    main()
