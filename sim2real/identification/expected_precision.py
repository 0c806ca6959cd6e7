"""Expected precision of a servo's parameters, before a fit."""

from __future__ import annotations

import numpy as np

from sim2real.effects import named
from sim2real.identification.priors import gains, of_effects
from sim2real.identification.problem import ServoProblem
from sim2real.identification.starts import first_guess
from sim2real.inference.normal import Z90
from sim2real.recording import PER_INERTIA, Recording
from sim2real.servo.trace import sensor_noise, traces


def expected_precision(recording: Recording, joint: str, *, seed: int = 0) -> tuple[str, ...]:
    """Parameters of one joint that the recording can and cannot identify, one sentence each.

    From the Fisher information of an approximate PD servo: half-widths of 90 % intervals if the
    joint is a PD servo and the noise is independent.
    """
    moving = traces([recording], joint)
    if not moving:
        return ("nothing can be identified: the joint does not move under command",)
    trace = moving[0]
    start = first_guess(moving, np.random.default_rng(seed))[0]
    inertia, kp = trace.load.inertia_kgm2, float(start[0])
    names, parameters = ["kp", "kd", "latency", "inertia left out"], list(gains(inertia))
    if trace.load is not PER_INERTIA and trace.load.gravity_Nm > 0:  # a pendulum
        parameters += of_effects([named("unmodelled_inertia")], start, inertia)
    problem = ServoProblem(moving, start, tuple(parameters))
    x = problem.searched(start[None])
    _, (slopes,) = problem.slopes(x, rough=False)
    size = problem.unit * np.where(problem.log, problem.values(x)[0], 1.0)
    unit = np.array([kp, max(start[1], 0.4 * np.sqrt(kp * inertia)), 0.05, inertia])[: size.size]
    scaled = slopes / size * unit / sensor_noise([trace])
    level, directions = np.linalg.eigh(scaled.T @ scaled)
    sd = np.sqrt((directions**2) @ (1 / np.maximum(level, 1e-12)))
    precise, units = [], ("N m/rad", "N m s/rad", "ms", "kg m2")
    for k in np.flatnonzero(sd < 1).tolist():
        half = Z90 * sd[k] * unit[k] * (1e3 if k == 2 else 1.0)
        share = 100 * half / start[k] if k < 2 and start[k] > 0 else np.inf
        how = f"{share:.2g} %" if share < 100 else f"{half:.2g} {units[k]}"
        precise.append(f"{names[k]} to {how}")
    per = " per unit of inertia" if trace.load is PER_INERTIA else ""
    sentences = [f"can identify{per}: {', '.join(precise)}"] if precise else []
    open_ones = [names[k] for k in np.flatnonzero(sd >= 1)]
    return (*sentences, f"cannot identify: {', '.join(open_ones)}") if open_ones else (*sentences,)
