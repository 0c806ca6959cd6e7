"""Expected precision of a servo's parameters, before a fit."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.first_guess import first_guess
from sim2real.identification.priors import gains, inertia_left_out
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import point_fit
from sim2real.inference.normal import Z90
from sim2real.noise import noise_floor
from sim2real.recording import PER_INERTIA, Recording
from sim2real.servo.trace import traces

_NAMES = ("kp", "kd", "latency", "inertia left out")


def expected_precision(recording: Recording, joint: str, *, seed: int = 0) -> tuple[str, ...]:
    """Parameters of one joint that the recording can and cannot identify, one sentence each.

    From the Fisher information of an approximate PD servo: half-widths of 90 % intervals if the
    joint is a PD servo and the noise is independent.
    """
    moving = traces([recording], joint)
    if not moving:
        return ("nothing can be identified: the joint does not move under command",)
    trace = moving[0]
    start, _ = first_guess(moving, np.random.default_rng(seed))
    inertia = trace.load.inertia_kgm2
    parameters = list(gains(inertia))
    if trace.load is not PER_INERTIA and trace.load.gravity_Nm > 0:  # a pendulum
        parameters.append(inertia_left_out(start, inertia))
    at_start = point_fit(ServoProblem(moving, start, tuple(parameters)), start)
    kp, kd = float(start[0]), max(float(start[1]), 0.4 * float(np.sqrt(start[0] * inertia)))
    unit = np.array([kp, kd, 0.05, inertia])[: len(parameters)]
    problem, noise = at_start.problem, noise_floor(trace.t, trace.command, trace.position)
    size = problem.unit * np.where(problem.log, at_start.values, 1.0)
    scaled = at_start.slopes / size * unit / max(noise, 1e-6)
    level, directions = np.linalg.eigh(scaled.T @ scaled)
    variance = (directions**2) @ (1 / np.maximum(level, 1e-12))
    half = Z90 * np.sqrt(variance) * unit
    determined = np.sqrt(variance) < 1
    identifiable = [_precision(k, half[k], start) for k in np.flatnonzero(determined).tolist()]
    unidentifiable = [_NAMES[k] for k in np.flatnonzero(~determined)]
    per = " per unit of inertia" if trace.load is PER_INERTIA else ""
    sentences = []
    if identifiable:
        sentences.append(f"can identify{per}: {', '.join(identifiable)}")
    if unidentifiable:
        sentences.append(f"cannot identify: {', '.join(unidentifiable)}")
    return tuple(sentences)


def _precision(index: int, half: float, start: Array) -> str:
    if index == 2:
        return f"latency to {1e3 * half:.2g} ms"
    if index == 3:
        return f"inertia left out to {half:.2g} kg m2"
    share = 100 * half / start[index] if start[index] > 0 else np.inf
    if share < 100:
        return f"{_NAMES[index]} to {share:.2g} %"
    return f"{_NAMES[index]} to {half:.2g} {('N m/rad', 'N m s/rad')[index]}"
