"""Batched rollouts: simulated angles of many parameter sets on commands or recordings."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.arrays import Array, Index, Integers
from sim2real.effects import CATALOGUE
from sim2real.recording import Load, VaryingLoad
from sim2real.servo.kernel import KERNELS
from sim2real.servo.motor import MOTOR_BIT
from sim2real.servo.parameters import (
    BASE,
    CELLS,
    FIRST_COLUMN,
    FIRST_MOTOR_COLUMN,
    beyond_load,
    context_factors,
)
from sim2real.servo.trace import Trace

STEPS_PER_RADIAN = 32.0
"""Sub-steps per radian of the fastest mode; half of them change no angle by more than 1e-4 rad."""
LONGEST_SUBSTEP_S = 0.002
SHORTEST_SUBSTEP_S = 20e-6
"""No servo has a mode that needs shorter ones: 500 Hz has 16 of them per radian."""
_COARSENING = 4.0
_LONGEST_COARSE_SUBSTEP_S = 0.004
Signals = tuple[Array, Array, Integers, Array, Array]
_LATENCY = BASE.index("latency_s")
_LOAD = slice(BASE.index("inertia_kgm2"), BASE.index("gravity_Nm") + 1)


def rollout(
    theta: Array,
    t: Array,
    command: Array,
    *,
    measured: Array | None = None,
    varying: VaryingLoad | None = None,
    steps_per_radian: float = STEPS_PER_RADIAN,
    substep_s: float | Array | None = None,
) -> Array:
    """Simulate servos from rest on their first command, or where friction is seen to hold them.

    The integration stops at every sample and at every arrival of a set-point, so that the latency
    is not rounded and no change of the command falls inside a sub-step.

    Args:
        theta: Parameters of B servos, shape (B, P), in the order of ``COLUMNS``.
        t: Times of commands and samples in s, shape (T,), increasing.
        command: Set-points in rad sent at ``t``, shape (T,); NaN where the torque is off.
        measured: Measured angles in rad, shape (T,), NaN where missing: those before the first
            change of the command show where the servo starts.
        varying: Load that varies with time, around the mean inertia that ``theta`` has.
        steps_per_radian: Sub-steps per radian of the fastest mode's phase, at most 2 ms long.
        substep_s: Instead of it the longest sub-step in s, for all rows or of shape (B,). A common
            value makes differences of rows smooth.

    Returns:
        Measured angles in rad at ``t``, shape (B, T).
    """
    rows = np.asarray(theta, dtype=np.float64)
    longest = substep_s
    if longest is None:
        steps = np.where(active_effects(rows) != 0, 2 * steps_per_radian, steps_per_radian)
        longest = longest_substep(rows, rows[:, BASE.index("inertia_kgm2")], steps)
    angles = np.full(t.size, np.nan) if measured is None else measured
    used = np.isfinite(angles)
    trace = Trace("", "", t, command, angles, Load(0.0), used, varying=varying)
    return Simulator([trace], add_loads=True).angles(rows, longest)[0]


def rollout_on(trace: Trace, theta: Array, *, substep_s: float | None = None) -> Array:
    """Measured angles in rad of servos (B, P) on a recording's commands and load, shape (B, T)."""
    factor, offset = trace_contexts([trace])
    rows = theta * factor + offset
    return rollout(
        rows, trace.t, trace.command, measured=trace.measured, varying=trace.varying,
        substep_s=substep_s,
    )  # fmt: skip


def longest_substep(
    theta: Array,
    inertia: Array,
    steps_per_radian: float | Array = STEPS_PER_RADIAN,
    longest_s: float = LONGEST_SUBSTEP_S,
) -> Array:
    """Longest sub-step in s that resolves the fastest mode, at least ``SHORTEST_SUBSTEP_S``.

    ``theta``: parameters, shape (..., P); ``inertia`` of the stated load in kg m2, shape (...).
    """
    kp, kd = np.abs(theta[..., 0]), theta[..., 1]
    total = inertia + beyond_load(theta)
    fastest = np.maximum(np.sqrt(kp / total), 0.5 * kd / total)
    steps: Array = 1 / np.maximum(steps_per_radian * fastest, 1e-9)
    return np.clip(steps, SHORTEST_SUBSTEP_S, longest_s)


def coarse_substep(substep_s: Array) -> Array:
    """Sub-steps for derivatives and for searches far from their minimum, in s.

    Up to four times as long as those of a residual, at most 4 ms. The discretisation error of a
    second-order scheme, about 1 % of a derivative, changes the path to a minimum but hardly the
    minimum itself, where the residual is orthogonal to all derivatives.
    """
    longest = np.maximum(substep_s, _LONGEST_COARSE_SUBSTEP_S)
    return np.minimum(longest, _COARSENING * substep_s)


def padded(traces: Sequence[Trace]) -> tuple[Signals, Array, Array]:
    """Recordings as arrays, padded to the length T of the longest.

    Returns:
        Times in s and set-points in rad, 0 beyond the end, shape (S, T), numbers of samples (S,);
        of loads that vary, time from the first value to the first sample in s, time between values
        in s, 0 for a constant load, number of values, and angle in rad at which the joint starts,
        NaN for rest on the first set-point, shape (S, 4), and inertia in kg m2 beyond
        the mean and torque in N m, shape (S, K, 2); measured angles in rad, NaN where not used, (S,
        T); inertia in kg m2 and gravity torque in N m of the loads, shape (S, 2).
    """
    length = np.array([trace.t.size for trace in traces], dtype=np.int32)
    t, command, position = (np.full((len(traces), length.max()), x) for x in (0.0, 0.0, np.nan))
    for s, trace in enumerate(traces):
        part = np.s_[s, : trace.t.size]
        t[part], command[part], position[part] = trace.t, trace.command, trace.measured
    load = np.array([[x.load.inertia_kgm2, x.load.gravity_Nm] for x in traces])
    grid, varying = np.zeros((len(traces), 4)), [x.varying for x in traces]
    values = np.zeros((len(traces), max((x.torque_Nm.size for x in varying if x), default=1), 2))
    grid[:, 3] = [trace.start_rad for trace in traces]
    for s, change in enumerate(varying):
        if change is not None:
            grid[s, :3] = t[s, 0] - change.start_s, change.step_s, change.torque_Nm.size
            beyond = change.inertia_kgm2 - change.mean_inertia_kgm2
            values[s, : beyond.size] = np.stack([beyond, change.torque_Nm], axis=1)
    return (t, command, length, grid, values), position, load


def trace_contexts(traces: Sequence[Trace]) -> tuple[Array, Array]:
    """Factors and offsets of a servo's parameters on S recordings, both of shape (S, P).

    A recording states a supply voltage, a firmware gain and a load, and when angles are sampled.
    """
    factor = np.array([context_factors(trace.supply_ratio, trace.gain_ratio) for trace in traces])
    factor[:, _LOAD] = 0.0
    offset = np.zeros_like(factor)
    offset[:, _LOAD] = [[x.load.inertia_kgm2, x.load.gravity_Nm] for x in traces]
    offset[:, _LATENCY] = [-trace.sample_delay_s for trace in traces]
    return factor, offset


class Simulator:
    """Simulates servos with any parameters on S recordings.

    Their loads are those of the recordings; with ``add_loads`` those of servos are added.
    """

    def __init__(self, traces: Sequence[Trace], *, add_loads: bool = False) -> None:
        self.traces = traces
        signals, self.position, self.load = padded(traces)
        self.length = signals[2]
        self._factor, self._offset = trace_contexts(traces)
        if add_loads:
            self._factor[:, _LOAD] = 1.0
        self._signals = [to_warp(x) for x in signals]

    def substeps(
        self,
        theta: Array,
        steps_per_radian: float = STEPS_PER_RADIAN,
        longest_s: float = LONGEST_SUBSTEP_S,
    ) -> Array:
        """Sub-step in s for each of the servos (B, P), shape (B,)."""
        inertia = self.load[:, 0, None]
        least: Array = longest_substep(theta, inertia, steps_per_radian, longest_s).min(axis=0)
        return least

    def angles(self, theta: Array, substep_s: float | Array) -> list[Array]:
        """Angles in rad of servos (B, P) with the load of each recording, one array (B, T) each.

        ``substep_s``: longest sub-step, a number or (B,).
        """
        S = len(self.traces)
        servo, signal = (x.ravel() for x in np.indices((len(theta), S)))
        angle = self.run(theta[servo], signal, np.broadcast_to(substep_s, len(theta))[servo])
        return [angle[s::S, : trace.t.size] for s, trace in enumerate(self.traces)]

    def run(self, theta: Array, signal: Index, longest_s: Array) -> Array:
        """Angles in rad of N rollouts, 0 beyond the end of a recording, shape (N, T).

        Of each: parameters (N, P), index of the recording (N,), longest sub-step in s (N,). Those
        without effects and with the same events are simulated in pairs.
        """
        rows = theta * self._factor[signal] + self._offset[signal]
        active = active_effects(rows)
        effects = bool(np.any(active & ~MOTOR_BIT))
        order = np.arange(len(rows))
        if not effects:
            order = np.lexsort((rows[:, _LATENCY], longest_s, signal))
        mask = wp.from_numpy(active, dtype=wp.int64, device="cpu")
        inputs = [to_warp(rows), mask, zeros((len(rows), CELLS)), to_warp(signal.astype(np.int32))]
        events, out = [*self._signals, to_warp(longest_s)], zeros((len(rows), self.length.max()))

        def simulate(some: Index) -> None:
            together, launches = (1, some.size) if effects else (some.size, 1)
            given = [*inputs, to_warp(some.astype(np.int32)), together, *events]
            wp.launch(KERNELS[effects, not effects], launches, given, [out], device="cpu")

        # Neighbouring rows take as long as each other: each thread has every second part of them.
        parts = np.array_split(order, max(1, len(rows) // 16))
        shares = [np.concatenate(parts[k::2]) for k in range(min(2, len(parts)))]
        list(_workers().map(simulate, shares))
        angles: Array = out.numpy()
        return angles


@cache
def _workers() -> ThreadPoolExecutor:
    """Threads that rollouts share; none of their tasks may wait for another."""
    return ThreadPoolExecutor(2)


def active_effects(rows: Array) -> NDArray[np.int64]:
    """Bit mask of the active effects and of the motor's law for each parameter row, (N,)."""
    firsts = [FIRST_MOTOR_COLUMN, *FIRST_COLUMN.values()]
    bits = np.array([MOTOR_BIT, *(1 << k for k in range(len(CATALOGUE)))])
    on = np.logical_or.reduceat(rows != 0, firsts, axis=1)
    return np.asarray(np.where(on, bits, 0).sum(axis=1))


def to_warp(values: NDArray[Any]) -> Any:  # noqa: ANN401 - Warp has no stubs
    """A copy as a Warp array of int32 or float64."""
    integers = values.dtype == np.int32
    copied = np.array(values, dtype=np.int32 if integers else np.float64, order="C")
    kind = wp.int32 if integers else wp.float64
    return wp.array(copied, dtype=kind, device="cpu", copy=False)  # Warp's own copy costs more


def zeros(shape: tuple[int, ...], dtype: type = wp.float64) -> Any:  # noqa: ANN401
    """A Warp array of zeros."""
    return wp.zeros(shape, dtype=dtype, device="cpu")
