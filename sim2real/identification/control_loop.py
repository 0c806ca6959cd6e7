"""When a sampled controller looks, where recordings show it.

A set-point waits for the controller's next look, so that steps come early and late by up to a
period. No search by slopes finds that: the error is flat in the period but at the true one. So the
delay of each large step is measured on its own; the times at which steps arrive then lie on a
lattice, whose period a periodogram shows (as of pulsars: Buccheri and others, Astron. Astrophys.
128 (1983) 245, one harmonic).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.motor_fit import MotorFit, refitted
from sim2real.servo.parameters import BASE, COLUMNS, LINE, LOOP, ROTOR
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_KP, _KD, _LATENCY = (BASE.index(n) for n in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"))


@dataclass(frozen=True)
class LoopSearch:
    """How the period of a sampled controller is searched.

    Attributes:
        rates_Hz: Rates of controllers that are looked for; a faster one cannot be told from none.
        most_steps: Steps of a recording whose delay is measured.
        least_step: Least of these steps, as a share of the largest.
        delay_s: Delay by which it is measured what one does.
        delay_sd_s: Prior standard deviation of the delays about their mean.
        in_step: Length of the mean phase of set-points from which on they keep step with a loop.
        fewest_steps: Steps from which a period can be told.
        candidates: Rates that are tried, besides those they may be harmonics of.
        latencies: Latencies that are tried with each rate.
        first_steps: Most steps of the first fits.
        phases: Phases that are tried about a fit.
        best: The best of these, which are refitted.
        rounds: Rounds of phases and refits.
    """

    rates_Hz: tuple[float, float] = (90.0, 1100.0)
    most_steps: int = 60
    least_step: float = 0.1
    delay_s: float = 1e-3
    delay_sd_s: float = 0.004
    in_step: float = 0.95
    fewest_steps: int = 12
    candidates: int = 6
    latencies: int = 16
    first_steps: int = 8
    phases: int = 64
    best: int = 2
    rounds: int = 3


LOOP_SEARCH = LoopSearch()
"""The defaults."""


def sampled(motor: MotorFit, *, search: LoopSearch = LOOP_SEARCH) -> MotorFit | None:
    """The fit with the sampled loop that explains the recordings best; its gain is not judged.

    From a fit without a loop, to whose latency the wait for the next look has added. All recordings
    start at one phase.

    Args:
        motor: A fit without a loop.
        search: Settings of the search.

    Returns:
        None where too few steps tell.
    """
    sent, delay, spread = arrivals(motor, search=search)
    if sent.size < search.fewest_steps:
        return None
    rates = _rates(sent + delay, spread, search=search)
    coarse = np.stack([_looped(motor, 1 / hz, sent, delay, spread, search=search) for hz in rates])
    loss = motor.rough_losses(np.concatenate(coarse)).reshape(coarse.shape[:2])
    near = coarse[np.arange(rates.size), loss.argmin(axis=1)]
    found = refitted(motor, near, search.first_steps)[0]
    for _ in range(search.rounds):
        fine = np.concatenate([found.x[None], _nearby(found, search=search)])
        found = refitted(found, fine[np.argsort(found.rough_losses(fine))[: search.best]])[0]
    return found


@dataclass(frozen=True)
class Hidden:
    """A loop that would show nowhere, and the gains that it would have to have.

    Attributes:
        period_s: Time between two looks.
        kp: Proportional gain in N m/rad, or per unit of inertia.
        kd: Derivative gain in N m s/rad, likewise.
    """

    period_s: float
    kp: float
    kd: float


def hidden(motor: MotorFit, *, search: LoopSearch = LOOP_SEARCH) -> Hidden | None:
    """The slowest sampled loop that the recordings cannot tell from none.

    One whose looks keep step with the set-points: each then waits as long as any other, which is as
    good as latency, and what it sees late as good as other gains.

    Args:
        motor: A fit without a loop.
        search: Settings of the search.

    Returns:
        None where set-points come at odd times, or where the fit has a loop.
    """
    if motor.fit.row[COLUMNS.index(LOOP[0])] > 0:
        return None
    moved = [t.t[1:][np.diff(t.command) != 0] - t.t[0] for t in motor.problem.traces]
    times = np.concatenate(moved)
    if times.size < 2:
        return None
    sampling = float(np.median(np.concatenate([np.diff(t.t) for t in motor.problem.traces])))
    for n in range(1, 1 + int(search.rates_Hz[1] * sampling)):
        period = sampling / n
        if 1 / period < search.rates_Hz[0]:
            continue
        if abs(np.exp(2j * np.pi * times / period).mean()) > search.in_step:
            return Hidden(period, *_held_gains(motor, period))
    return None


def arrivals(motor: MotorFit, *, search: LoopSearch = LOOP_SEARCH) -> tuple[Array, Array, Array]:
    """When large steps of the command were sent, how late they acted, its spreads, in s, (K,).

    Args:
        motor: A fit without a loop.
        search: Settings of the search.
    """
    times, delays, spreads = [], [], []
    scale = motor.fit.scale_rad
    for trace, error, slopes in zip(
        motor.problem.traces, motor.fit.residuals, motor.fit.jacobians, strict=True
    ):
        jump = np.abs(np.diff(trace.command, prepend=trace.command[0]))
        step = np.flatnonzero(jump > search.least_step * jump.max())
        step = np.sort(step[np.argsort(-jump[step])[: search.most_steps]])
        step = step[(step > 0) & (step < trace.t.size - 1)]
        if not step.size:
            continue
        late = _effect_of_delay(motor, trace, step, search=search)[trace.used]
        units = np.maximum(np.abs(slopes).max(axis=0), 1e-12)
        every = np.hstack([late, slopes / units])
        prior_precision = np.concatenate(
            [np.full(step.size, (scale / search.delay_sd_s) ** 2), 1e-9 + 0 * units]
        )
        precision = every.T @ every + np.diag(prior_precision)
        inverse = np.linalg.inv(precision)
        delay = -(inverse @ (every.T @ error))[: step.size]
        times.append(trace.t[step] - trace.t[0])
        delays.append(motor.fit.row[_LATENCY] + delay)
        spreads.append(scale * np.sqrt(np.diag(inverse)[: step.size]))
    if not times:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    return np.concatenate(times), np.concatenate(delays), np.concatenate(spreads)


def _effect_of_delay(
    motor: MotorFit, trace: Trace, step: NDArray[np.intp], *, search: LoopSearch
) -> Array:
    """Derivatives of the angle by the delay of each step, rad/s, shape (T, K)."""
    moved = [trace]
    for k in step:
        later = min(search.delay_s, 0.5 * float(trace.t[k + 1] - trace.t[k]))
        command = np.insert(trace.command, k, trace.command[k - 1])
        moved.append(
            replace(
                trace,
                t=np.insert(trace.t, k + 1, trace.t[k] + later),
                command=command,
                position=np.insert(trace.position, k, np.nan),
                used=np.insert(trace.used, k, False),
            )
        )
    angle = Simulator(moved).angles(motor.fit.row[None], motor.problem.substep_s)
    late = [
        (np.delete(one[0], k + 1) - angle[0][0]) / (more.t[k + 1] - more.t[k])
        for k, one, more in zip(step, angle[1:], moved[1:], strict=True)
    ]
    return np.stack(late, axis=1)


def _rates(times: Array, spread: Array, *, search: LoopSearch) -> Array:
    """Rates in Hz at which the times lie best on a lattice, best first."""
    fine = 0.2 / max(float(np.ptp(times)), 1e-3)
    rates = np.arange(*search.rates_Hz, fine)
    power = np.empty(rates.size)
    block = max(1, 10**6 // times.size)
    turned = np.exp(2j * np.pi * fine * np.arange(min(block, rates.size))[:, None] * times)
    for first in range(0, rates.size, block):
        hz = rates[first : first + block, None]
        weight = np.exp(-2 * (np.pi * hz * spread) ** 2)
        begin = np.exp(2j * np.pi * rates[first] * times)
        together = np.abs(np.einsum("rk,rk,k->r", weight, turned[: hz.size], begin)) ** 2
        power[first : first + block] = together / np.maximum((weight**2).sum(axis=1), 1e-9)
    chosen: list[float] = []
    for k in np.argsort(-power):
        if all(abs(rates[k] - other) > 5 * fine for other in chosen):
            chosen.append(float(rates[k]))
        if len(chosen) == search.candidates:
            break
    for slower in [one / n for one in chosen for n in (2, 3)]:  # whose harmonics they may be
        if slower > search.rates_Hz[0] and all(abs(slower - other) > 5 * fine for other in chosen):
            chosen.append(slower)
    return np.array(chosen)


def _looped(
    motor: MotorFit,
    period_s: float,
    sent: Array,
    delay: Array,
    spread: Array,
    *,
    search: LoopSearch,
) -> Array:
    """Servos as searched with a loop of that period, one a latency, shape (latencies, F).

    The phase is that of the arrivals; the latency is shorter than any delay by up to a period.
    """
    prior = motor.problem.prior
    weight = np.exp(-2 * (np.pi * spread / period_s) ** 2)
    turn = np.angle((weight * np.exp(2j * np.pi * (sent + delay) / period_s)).sum())
    x = np.tile(motor.x, (search.latencies, 1))
    shortest = float(np.median(delay)) - period_s * np.linspace(0, 1, search.latencies)
    x[:, _LATENCY] = np.maximum(shortest, 0.0)
    x[:, prior.index(LOOP[0])] = period_s
    x[:, prior.index(LOOP[1])] = (turn / (2 * np.pi) * period_s - x[:, _LATENCY]) % period_s
    kp, kd = _held_gains(motor, period_s)
    x[:, _KP], x[:, _KD] = np.log(kp), np.log(kd)
    return x


def _held_gains(motor: MotorFit, period_s: float) -> tuple[float, float]:
    """Gains kp, kd with a loop that act as those of the fit do without.

    What is seen half a period late: kp (e + v P / 2) - (kd - b) (v - a P / 2) - b v; the first
    takes from the damping, the second, by the back-EMF's b, adds to the inertia.
    """
    row, half = motor.fit.row, 0.5 * period_s
    kp, kd = (float(x) for x in row[[_KP, _KD]])
    line = row[[COLUMNS.index(name) for name in LINE]]
    back = line[0] / line[1] if line.all() else kd
    inertia = motor.fit.inertia + float(row[COLUMNS.index(ROTOR)])
    more = (1 + back * half / inertia) / (1 + (kd + kp * half) * half / inertia)
    return more * kp, more * (kd + kp * half)


def _nearby(found: MotorFit, *, search: LoopSearch) -> Array:
    """Servos as searched, set-points of which wait for an earlier or a later look."""
    prior = found.problem.prior
    length, phase = found.x[prior.index(LOOP[0])], prior.index(LOOP[1])
    near = np.linspace(-0.5, 0.5, search.phases + 1) * length
    x = np.tile(found.x, (near.size, 1))
    x[:, _LATENCY] = np.maximum(x[:, _LATENCY] - near, 0.0)  # the looks stay where they are
    x[:, phase] = (found.x[phase] + found.x[_LATENCY] - x[:, _LATENCY]) % length
    return x
