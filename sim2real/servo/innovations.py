"""Sums of squared innovations of many servos at once: how a posterior is sampled."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.servo.closed_form import innovation_energy, plain_servos
from sim2real.servo.kernel import simulate_servos
from sim2real.servo.parameters import BASE, CELLS
from sim2real.servo.rollout import active_effects, to_warp
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_LANES = 4
"""Coefficients of the autoregression are padded to a multiple of this."""
_LOAD = slice(BASE.index("inertia_kgm2"), BASE.index("gravity_Nm") + 1)


@dataclass(frozen=True)
class WhitenedServo:
    """Recordings of one joint, ready for servos of any parameters.

    Attributes:
        traces: The recordings.
        counts: Samples whose innovations count, one array (T,) a recording.
        autoregression: The noise model, shape (p,).
        substep_s: Longest sub-step of rollouts, the same for all servos, so that the sums are
            smooth; None for the closed form, which knows gains and latency alone.
        threads: CPU threads.
    """

    traces: Sequence[Trace]
    counts: Sequence[NDArray[np.bool_]]
    autoregression: Array
    substep_s: float | None = None
    threads: int = 2

    def angles(self, theta: Array) -> list[Array]:
        """Angles in rad of servos (B, P), for each trace of shape (B, T); loads are the traces'."""
        angle = self._simulated(np.ascontiguousarray(theta)).numpy()
        S = len(self.traces)
        return [angle[s::S, : trace.t.size] for s, trace in enumerate(self.traces)]

    def energy(self, theta: Array) -> Array:
        """Sum of squared innovations in rad2 of servos (B, P), shape (B,).

        The bits of each do not depend on the rows beside it.
        """
        parts = [part for part in np.array_split(theta, self.threads) if part.size]
        found = list(self._pool.map(self._energy, parts)) if len(parts) > 1 else None
        sums = np.concatenate(found or [self._energy(parts[0])])
        return np.asarray(sums.reshape(theta.shape[0], -1).sum(axis=1))

    def _energy(self, theta: Array) -> Array:
        """Sums of some servos, one a servo and recording."""
        angle = self._simulated(np.ascontiguousarray(theta))
        sums: Any = wp.zeros(angle.shape[0], dtype=wp.float64, device="cpu")
        names = ("length", "position", "counts", "autoregression")
        inputs = [len(self.traces), self.autoregression.size, *map(self._given.get, names), angle]
        wp.launch(
            innovation_energy, dim=angle.shape[0], inputs=inputs, outputs=[sums], device="cpu"
        )
        taken: Array = sums.numpy()
        return taken

    def _simulated(self, theta: Array) -> Any:  # noqa: ANN401 - Warp has no stubs
        """Angles of servos (B, P), one row a servo and recording."""
        S = len(self.traces)
        rows = theta.shape[0] * S
        angle: Any = wp.empty((rows, self._given["t"].shape[1]), dtype=wp.float64, device="cpu")
        if self.substep_s is None:
            servo = to_warp(theta[:, :3], "cpu")
            events = ("inertia", "t", "length", "change_t", "change_u", "changes")
            inputs = [servo, S, *map(self._given.get, events)]
            wp.launch(plain_servos, dim=rows, inputs=inputs, outputs=[angle], device="cpu")
            return angle
        table = np.repeat(theta, S, axis=0)
        loads = [(trace.load.inertia_kgm2, trace.load.gravity_Nm) for trace in self.traces]
        table[:, _LOAD] = np.tile(np.array(loads), (theta.shape[0], 1))
        signal = np.tile(np.arange(S, dtype=np.int32), theta.shape[0])
        own = (table, active_effects(table), np.zeros((rows, CELLS)), signal)
        names = ("t", "command", "length")
        longest = to_warp(np.full(rows, self.substep_s), "cpu")
        inputs = [*(to_warp(x, "cpu") for x in own), *map(self._given.get, names), 0.0, longest]
        wp.launch(simulate_servos, dim=rows, inputs=inputs, outputs=[angle], device="cpu")
        return angle

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.threads)

    @cached_property
    def _given(self) -> dict[str, Any]:
        """The recordings as Warp arrays by name."""
        S, T = len(self.traces), max(trace.t.size for trace in self.traces)
        t, command, change_t, change_u = (np.zeros((S, T)) for _ in range(4))
        position, counts = np.full((S, T), np.nan), np.zeros((S, T), dtype=np.int32)
        changes = np.zeros(S, dtype=np.int32)
        for s, trace in enumerate(self.traces):
            part = np.s_[s, : trace.t.size]
            t[part], command[part], counts[part] = trace.t, trace.command, self.counts[s]
            position[part] = np.where(trace.used, trace.position, np.nan)
            at = np.concatenate([[0], 1 + np.flatnonzero(np.diff(trace.command))])
            changes[s] = at.size
            change_t[s, : at.size], change_u[s, : at.size] = trace.t[at], trace.command[at]
        p = self.autoregression.size
        values = {
            "inertia": np.array([trace.load.inertia_kgm2 for trace in self.traces]),
            "length": np.array([trace.t.size for trace in self.traces], dtype=np.int32),
            "t": t,
            "command": command,
            "change_t": change_t,
            "change_u": change_u,
            "changes": changes,
            "position": position,
            "counts": counts,
            "autoregression": np.pad(self.autoregression, (0, -p % _LANES if p else _LANES)),
        }
        return {name: to_warp(value, "cpu") for name, value in values.items()}
