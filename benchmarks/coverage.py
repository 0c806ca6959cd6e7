"""Simulation-based calibration of the servo posterior: do its intervals hold what they promise?

Servos are drawn from a prior, recorded, and sampled under the same prior. The rank of the truth
among the draws is then uniform: Talts, Betancourt, Simpson, Vehtari, Gelman, Validating Bayesian
inference algorithms with simulation-based calibration, arXiv:1804.06788 (2018). The recordings come
from a closed form that shares no code with the library: a sum of step responses. Their noise is
correlated in time, and how much is not told to the sampler.

    python benchmarks/coverage.py --cases 400 --out reports/coverage [--processes 16]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from harness import command_line, spread
from scipy.stats import binom

from sim2real.arrays import Array
from sim2real.identification.identify import identify
from sim2real.inference.parameters import Parameter
from sim2real.output import write_json, write_whole
from sim2real.posterior.chain import LEAST_TIMES
from sim2real.posterior.servo import sample_servo
from sim2real.recording import Load, Recording
from sim2real.report.style import ACCENT, FAINT, RULE, house_style, new_figure
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.trace import trace

INERTIA = 0.002
DRAWN = (
    Parameter("kp_Nm_per_rad", 0.6, 6.0, 2.0, log=True),
    Parameter("kd_Nms_per_rad", 0.02, 0.2, 0.06, log=True),
    Parameter("latency_s", 0.02, 0.12, 0.05),
)
LEVELS = (0.5, 0.8, 0.95)
SECONDS, RATE_HZ, JITTER_S = 30.0, 50.0, 0.001
WHITE_RAD, WANDER_RAD = 0.0015, 0.0015
WANDER_S = (0.05, 1.0)
STEPS = (800, 4000, 20000)
DRAWS, BINS = 199, 10
TITLES = ("kp", "kd", "latency")


def main() -> None:
    """Run the cases, write figures, table and ranks."""
    options = command_line(
        __doc__, cases=400, seed=20, out=Path("reports/coverage"), processes=1
    ).parse_args()
    seeds = np.random.SeedSequence(options.seed).spawn(options.cases)
    found = [one_case(seeds[0])]  # alone: it compiles what the others load
    found += spread(one_case, seeds[1:], options.processes, unit="servo")
    ranks, spans = zip(*found, strict=True)
    write(np.array(ranks), np.array(spans), options.seed, options.out)


def one_case(case: np.random.SeedSequence) -> tuple[list[int], float]:
    """Ranks of the true parameters among the draws, and the length of the chain in its times."""
    rng = np.random.default_rng(case)
    share = rng.random(len(DRAWN))
    ends = [(np.log([p.low, p.high]) if p.log else (p.low, p.high)) for p in DRAWN]
    drawn = np.array([low + (high - low) * x for (low, high), x in zip(ends, share, strict=True)])
    truth = np.where([p.log for p in DRAWN], np.exp(drawn), drawn)
    recording = recorded(truth, rng)
    model = identify([recording], ROBOT, law="pd").joints["j1"]
    given, seed = [trace(recording, "j1")], int(rng.integers(2**31))
    for steps in STEPS:  # longer where the chain is too short to be published
        found = sample_servo(given, model, seed=seed, steps=steps)
        if found.convergence.reached:
            break
    draws = found.values[rng.choice(found.values.shape[0], DRAWS, replace=False)]
    return [int(r) for r in (draws < truth).sum(axis=0)], found.convergence.spans


def recorded(servo: Array, rng: np.random.Generator) -> Recording:
    """Half a minute of a servo (kp, kd, latency) that is sent random steps."""
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    t = t + rng.uniform(-JITTER_S, JITTER_S, t.size)
    edges = 0.5 + np.cumsum(rng.uniform(0.3, 0.9, 100))
    levels = np.concatenate([[0.0], rng.uniform(-0.6, 0.6, edges.size)])
    command = levels[np.searchsorted(edges, t, side="right")]
    noise = WHITE_RAD * rng.standard_normal(t.size)
    noise += wander(t, WANDER_RAD, math.exp(rng.uniform(*np.log(WANDER_S))), rng)
    position = answered(t, command, *(float(x) for x in servo)) + noise
    load = {"j1": Load(INERTIA)}
    return Recording("steps", "servo", ("j1",), t, command[:, None], position[:, None], load)


def answered(t: Array, command: Array, kp: float, kd: float, latency: float) -> Array:
    """Angles (T,) of a PD servo on an inertia: the sum of its answers to every step of command."""
    moves = 1 + np.flatnonzero(np.diff(command))
    angle = np.full(t.size, command[0])
    for k in moves:
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


def covered(ranks: Array, level: float) -> Array:
    """Share of cases whose truth lies in the central interval of this level, shape (F,).

    A rank r of L draws is a quantile (r + 1/2) / (L + 1).
    """
    quantile = (ranks + 0.5) / (DRAWS + 1)
    return np.asarray((np.abs(quantile - 0.5) < level / 2).mean(axis=0))


def write(ranks: Array, spans: Array, seed: int, out: Path) -> None:
    """Write ranks, table and figure."""
    from sim2real.report.drawing import save_png

    cases = ranks.shape[0]
    shares = {level: covered(ranks, level) for level in LEVELS}
    worst = max(float(np.abs(share - level).max()) for level, share in shares.items())
    names = [p.name for p in DRAWN]
    content = {
        "cases": cases,
        "seed": seed,
        "coverage": {
            f"{level:g}": dict(zip(names, (float(x) for x in share), strict=True))
            for level, share in shares.items()
        },
        "worst_points": 100 * worst,
        "chain_in_times": [round(float(x), 1) for x in spans],
        "ranks": {name: [int(r) for r in ranks[:, k]] for k, name in enumerate(names)},
    }
    write_json(out / "coverage.json", content)
    save_png(figure(ranks), out / "ranks.png")
    write_whole(out / "README.md", text(shares, cases, worst, spans))
    print(text(shares, cases, worst, spans))


def text(shares: dict[float, Array], cases: int, worst: float, spans: Array) -> str:
    """The table in words."""
    lines = [
        "# Do the intervals of a servo's posterior hold what they promise?",
        "",
        f"{cases} simulated servos, each drawn from the prior, recorded for {SECONDS:.0f} s of "
        "steps at 50 Hz",
        "with noise that is correlated in time, and sampled by `sim2real.posterior`.",
        "The recordings are sums of closed-form step responses; they share no code with the "
        "library.",
        "",
        "| central interval | " + " | ".join(TITLES) + " | chance alone (95 %) |",
        "|---|" + "---|" * (len(TITLES) + 1),
    ]
    for level, share in shares.items():
        low, high = (100 * binom.ppf(p, cases, level) / cases for p in (0.025, 0.975))
        cells = " | ".join(f"{100 * x:.1f} %" for x in share)
        lines.append(f"| {100 * level:g} % | {cells} | {low:.1f} to {high:.1f} % |")
    lines += [
        "",
        f"The farthest is {100 * worst:.1f} points off; the bar is 5. Every chain that spans less "
        f"than {LEAST_TIMES} of its",
        f"autocorrelation times is sampled again with more steps, up to {STEPS[-1]}; "
        f"{int((spans < LEAST_TIMES).sum())} of them stay below, the",
        f"shortest at {spans.min():.0f}.",
        "",
        "![Rank histograms](ranks.png)",
        "",
        f"Rank of the truth among {DRAWS} draws: flat where the posterior is right; the band is "
        "where 95 % of the bars fall by chance.",
        "",
        "Drawn: " + "; ".join(f"`{p.name}` {p}" for p in DRAWN) + ".",
        f"Noise: white of {1e3 * WHITE_RAD:g} mrad plus an Ornstein-Uhlenbeck process of "
        f"{1e3 * WANDER_RAD:g} mrad with a",
        f"correlation time of {WANDER_S[0]:g} to {WANDER_S[1]:g} s, drawn anew for each servo.",
        "What this does not show: how the intervals fare where physics is missing from the model.",
        "",
        "Made by `python benchmarks/coverage.py`.",
        "",
    ]
    return "\n".join(lines)


def figure(ranks: Array):  # noqa: ANN201 - Matplotlib is loaded when drawn
    """Rank histograms, one panel a parameter."""
    cases = ranks.shape[0]
    band = [binom.ppf(p, cases, 1 / BINS) for p in (0.025, 0.975)]
    with house_style():
        drawn = new_figure(190, "rank histograms of kp, kd and latency")
        panels: Sequence = drawn.subplots(1, len(TITLES), sharey=True)
        for k, axes in enumerate(panels):
            axes.axhspan(*band, color=RULE, linewidth=0)
            axes.axhline(cases / BINS, color=FAINT, linewidth=0.8)
            edges = np.linspace(-0.5, DRAWS + 0.5, BINS + 1)
            counts, _ = np.histogram(ranks[:, k], edges)
            axes.bar(edges[:-1], counts, width=np.diff(edges) * 0.9, align="edge", color=ACCENT)
            axes.set_title(TITLES[k])
            axes.set_xlabel("rank of the truth")
        panels[0].set_ylabel("servos")
    return drawn


_SERVO = Servo("bench", 1.67, 5.24, 0.0)
_LINK = Link("link", 0.3, 0.1, 0.1, 0.1)
ROBOT = Robot("bench", (_LINK, _LINK), (Joint("j1", _SERVO, (-1.0, 1.0)),))

if __name__ == "__main__":
    main()
