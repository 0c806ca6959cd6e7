"""Period and phase of a sampled controller, where recordings determine them.

A set-point takes effect at the controller's next sample, so that the delay varies by up to a
period. A gradient search does not find the period: the error is flat except near the true value.
The delay of each large step is therefore estimated separately. The arrival times then lie on a
lattice, whose period is found by a periodogram (as for pulsars: Buccheri and others, Astron.
Astrophys. 128 (1983) 245, one harmonic).
"""

from dataclasses import replace

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.identification.priors import MotorPrior
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import fit, search
from sim2real.inference.parameters import apart
from sim2real.servo.parameters import BASE, COLUMNS, LINE_COLUMNS, LOOP, ROTOR_INERTIA, beyond_load
from sim2real.servo.trace import Trace

_KP, _KD, _LATENCY = (BASE.index(n) for n in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"))
_LOOP = [COLUMNS.index(name) for name in LOOP]
_RATES_HZ = (90.0, 1100.0)
"""Range of rates; faster loops are not distinguishable from continuous ones."""


def fit_sampled_loop(motor: Fit, prior: MotorPrior) -> Fit | None:
    """Fit a sampled loop, without a test of its significance; None with less than 12 large steps.

    The latency of the ``motor`` without a loop includes the mean wait for the next sample. All
    recordings are assumed to start at the same phase. After a search of 8 evaluations for each
    period, the best two of 64 earlier and later phases are searched on, three times.
    """
    sent, delay, spread = _arrivals(motor)
    if sent.size < 12:
        return None
    free = (*motor.parameters, *prior.of(LOOP[:1]))
    problem = replace(motor.problem, parameters=free)
    noise = motor.scale_rad, motor.inflation

    def ranked(rows: Array) -> Array:
        error = problem.row_residuals(rows, rough=True)
        return np.asarray(rows[np.argsort(problem.loss(problem.searched(rows), error, *noise))])

    rates = _rates(sent + delay, spread)
    coarse = [ranked(_starts(motor, 1 / hz, sent, delay, spread))[:1] for hz in rates]
    row = _searched(problem, np.concatenate(coarse), noise, 8)
    for _ in range(3):
        others = np.tile(row, (65, 1))  # set-points wait for other samples
        others[:, _LATENCY] -= np.linspace(-0.5, 0.5, 65) * row[_LOOP[0]]
        others[:, _LATENCY] = np.maximum(others[:, _LATENCY], 0.0)
        row = _searched(problem, ranked(np.concatenate([row[None], others]))[:2], noise, 10)
    return fit(replace(problem, row=row), row[None], rounds=1, first=1)


def _searched(problem: ServoProblem, rows: Array, noise: tuple[float, float], steps: int) -> Array:
    """The best servo (P,) of searches from some (S, P), each with its phase of the loop."""
    found = []
    for row in rows:
        own = replace(problem, row=row)
        x, loss, _ = search(own, own.searched(row[None]), noise, steps)
        found.append((float(loss[0]), own.rows(x)[0]))
    best: Array = min(found, key=lambda pair: pair[0])[1]
    return best


def undetected_loop(motor: Fit, *, synchronous: float = 0.95) -> tuple[float, float, float] | None:
    """Period in s, kp and kd of the slowest sampled loop that is taken for a continuous one.

    Its samples are synchronous with the set-points, whose mean phase vector is longer than
    ``synchronous``: the wait is then equal for all set-points and equivalent to latency, and the
    delay of the measurement is equivalent to other gains. None if set-points are sent at irregular
    times, or if the fit has a loop.
    """
    if motor.row[_LOOP[0]] > 0:
        return None
    changes = [t.t[1:][np.diff(t.command) != 0] - t.t[0] for t in motor.problem.traces]
    times = np.concatenate(changes)
    if times.size < 2:
        return None
    sampling = float(np.median(np.concatenate([np.diff(t.t) for t in motor.problem.traces])))
    for n in range(1, 1 + int(_RATES_HZ[1] * sampling)):
        period = sampling / n
        coherence = abs(np.exp(2j * np.pi * times / period).mean())
        if coherence > synchronous and 1 / period >= _RATES_HZ[0]:
            return period, *_equivalent_gains(motor, period)
    return None


def _arrivals(motor: Fit, *, delay_sd_s: float = 0.004) -> tuple[Array, Array, Array]:
    """Times of large steps of the command, their delays and standard deviations, in s, (K,)."""
    times, delays, spreads = [], [], []
    scale = motor.scale_rad
    by_trace = motor.residuals, motor.problem.by_trace(motor.slopes)
    for trace, error, slopes in zip(motor.problem.traces, *by_trace, strict=True):
        jump = np.abs(np.diff(trace.command, prepend=trace.command[0]))
        step = np.flatnonzero(jump > 0.1 * jump.max())
        step = np.sort(step[np.argsort(-jump[step])[:60]])
        step = step[(step > 0) & (step < trace.t.size - 1)]
        if not step.size:
            continue
        delayed = _effect_of_delay(motor, trace, step)[trace.used]
        units = np.maximum(np.abs(slopes).max(axis=0), 1e-12)
        slope_matrix = np.hstack([delayed, slopes / units])
        prior = np.repeat([(scale / delay_sd_s) ** 2, 1e-9], [step.size, units.size])
        inverse = np.linalg.inv(slope_matrix.T @ slope_matrix + np.diag(prior))
        delay = -(inverse @ (slope_matrix.T @ error))[: step.size]
        times.append(trace.t[step] - trace.t[0])
        delays.append(motor.row[_LATENCY] + delay)
        spreads.append(scale * np.sqrt(np.diag(inverse)[: step.size]))
    sent, delay, spread = (np.concatenate([[], *x]) for x in (times, delays, spreads))
    return sent, delay, spread


def _effect_of_delay(motor: Fit, trace: Trace, step: Index) -> Array:
    """Derivatives of the angle by the delay of each step, rad/s, shape (T, K).

    As far as the motor's torque allows, minus the speed at which a linear servo responds to it.
    """
    kp, kd, latency = (float(x) for x in motor.row[:3])
    inertia = trace.load.inertia_kgm2 + float(beyond_load(motor.row))
    roots = np.roots([inertia, kd, kp + trace.load.gravity_Nm]).astype(complex)
    roots[1] += 1e-6 * abs(roots[1])  # they differ
    change = np.diff(trace.command, prepend=trace.command[0])[step]
    stall = motor.row[LINE_COLUMNS[0]]
    if stall > 0:
        change = np.clip(change, -stall / kp, stall / kp)
    since = np.maximum(trace.t[:, None] - trace.t[step] - latency, 0.0)
    response = kp / inertia / (roots[0] - roots[1])
    waves = np.exp(roots[0] * since) - np.exp(roots[1] * since)
    return np.asarray(-change * np.real(response * waves))


def _rates(times: Array, spread: Array) -> Array:
    """Rates in Hz of the six lattices that fit the times best, and their subharmonics."""
    fine = 0.2 / max(float(np.ptp(times)), 1e-3)
    rates = np.arange(*_RATES_HZ, fine)
    power = np.empty(rates.size)
    block = max(1, 10**6 // times.size)
    turned = np.exp(2j * np.pi * fine * np.arange(min(block, rates.size))[:, None] * times)
    for first in range(0, rates.size, block):
        hz = rates[first : first + block, None]
        weight = np.exp(-2 * (np.pi * hz * spread) ** 2)
        begin = np.exp(2j * np.pi * rates[first] * times)
        coherence = np.abs(np.einsum("rk,rk,k->r", weight, turned[: hz.size], begin)) ** 2
        power[first : first + block] = coherence / np.maximum((weight**2).sum(axis=1), 1e-9)
    order = np.argsort(-power)
    chosen = rates[order[apart(rates[order, None], 5 * fine, 6)]]
    lower = np.concatenate([chosen, chosen / 2, chosen / 3])  # of harmonics
    lower = lower[lower > _RATES_HZ[0]]
    return np.asarray(lower[apart(lower[:, None], 5 * fine)])


def _starts(
    motor: Fit, period_s: float, sent: Array, delay: Array, spread: Array, *, count: int = 16
) -> Array:
    """Servos (count, P) with a loop of this period and the arrivals' phase, of some latencies."""
    weight = np.exp(-2 * (np.pi * spread / period_s) ** 2)
    turn = np.angle((weight * np.exp(2j * np.pi * (sent + delay) / period_s)).sum())
    rows = np.tile(motor.row, (count, 1))
    shortest = float(np.median(delay)) - period_s * np.linspace(0, 1, count)
    rows[:, _LATENCY] = np.maximum(shortest, 0.0)
    rows[:, _LOOP] = period_s, (turn / (2 * np.pi) * period_s) % period_s
    rows[:, [_KP, _KD]] = _equivalent_gains(motor, period_s)
    return rows


def _equivalent_gains(motor: Fit, period_s: float) -> tuple[float, float]:
    """Gains kp, kd with a loop that are equivalent to those of the fit without.

    A delay of half a period P makes the torque kp (e + v P / 2) - (kd - b) (v - a P / 2) - b v, b
    from the back-EMF: less damping by the first term, more inertia by the second.
    """
    half, line = 0.5 * period_s, motor.row[LINE_COLUMNS]
    kp, kd = (float(x) for x in motor.row[[_KP, _KD]])
    back_emf = line[0] / line[1] if line.all() else kd
    inertia = motor.inertia + float(motor.row[ROTOR_INERTIA])
    ratio = (1 + back_emf * half / inertia) / (1 + (kd + kp * half) * half / inertia)
    return ratio * kp, ratio * (kd + kp * half)
