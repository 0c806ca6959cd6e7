"""Batched rollouts: many parameter sets, one command signal, measured angles out."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.effects import CATALOGUE
from sim2real.servo.kernel import simulate_servos
from sim2real.servo.motor import MOTOR_BIT
from sim2real.servo.parameters import CELLS, COLUMNS, FIRST_COLUMN, FIRST_MOTOR_COLUMN, MOTOR

Array = NDArray[np.float64]

STEPS_PER_RADIAN = 32.0
"""Sub-steps while the fastest mode turns by one radian: halving them moves nothing by 1e-4 rad."""
LONGEST_SUBSTEP_S = 0.002
_MOST_EFFECTS = 30


def rollout(
    theta: Array,
    t: Array,
    command: Array,
    *,
    steps_per_radian: float = STEPS_PER_RADIAN,
    substep_s: float | None = None,
    device: str = "cpu",
    threads: int = 1,
) -> Array:
    """Simulate servos from rest on their first command.

    The clock stops at every sample to be written and at every set-point that arrives at a joint, so
    latency is any real number of seconds and no command edge falls inside a sub-step.

    Args:
        theta: Parameters, shape (B, J * P), joint by joint in the order of ``COLUMNS``.
        t: Times of commands and samples in s, shape (T,), increasing.
        command: Set-points in rad sent at ``t``, shape (T, J); NaN where the torque is off.
        steps_per_radian: Sub-steps per radian of the fastest mode's phase.
        substep_s: Longest sub-step in s; by ``steps_per_radian``, and at most 2 ms, where None. One
            length for all rows makes differences between them smooth.
        device: Warp device.
        threads: CPU threads to share the batch.

    Returns:
        Measured angles in rad at ``t``, shape (B, T, J).
    """
    B, (T, J) = theta.shape[0], command.shape
    rows = np.ascontiguousarray(theta, dtype=np.float64).reshape(B * J, len(COLUMNS))
    position = np.empty((B * J, T))
    fine, step = (steps_per_radian, LONGEST_SUBSTEP_S) if substep_s is None else (0.0, substep_s)
    active = active_effects(rows)
    signal = np.tile(np.arange(J, dtype=np.int32), B)
    signals = [
        to_warp(x, device) for x in (np.tile(t, (J, 1)), command.T, np.full(J, T, dtype=np.int32))
    ]

    def simulate(part: slice) -> None:
        memory = np.zeros((part.stop - part.start, CELLS))
        longest = np.full(memory.shape[0], step)
        given = (rows[part], active[part], memory, signal[part])
        out: Any = wp.array(position[part], dtype=wp.float64, device=device, copy=False)
        wp.launch(
            simulate_servos,
            dim=out.shape[0],
            inputs=[*(to_warp(x, device) for x in given), *signals, fine, to_warp(longest, device)],
            outputs=[out],
            device=device,
        )
        if out.device.is_cuda:  # on a CPU it is the same memory
            position[part] = out.numpy()

    edges = np.linspace(0, B * J, min(max(threads, 1), B * J) + 1).astype(int)
    parts = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    if len(parts) == 1:
        simulate(parts[0])
    else:
        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(simulate, parts))
    return np.moveaxis(position.reshape(B, J, T), 1, 2)


def active_effects(rows: Array) -> NDArray[np.int32]:
    """Bit mask of the effects that are on in each parameter row, and of the motor's law, (N,).

    Raises:
        OverflowError: If the catalogue has more effects than the mask has bits.
    """
    if len(CATALOGUE) > _MOST_EFFECTS:
        raise OverflowError(f"{len(CATALOGUE)} effects; the mask has {_MOST_EFFECTS} bits")
    motor = rows[:, FIRST_MOTOR_COLUMN : FIRST_MOTOR_COLUMN + len(MOTOR)].any(axis=1)
    active = motor.astype(np.int32) * np.int32(MOTOR_BIT)
    for k, effect in enumerate(CATALOGUE):
        first = FIRST_COLUMN[effect.name]
        on = rows[:, first : first + len(effect.parameters)].any(axis=1)
        active |= on.astype(np.int32) << np.int32(k)
    return active


def to_warp(values: NDArray[Any], device: str) -> Any:  # noqa: ANN401 - Warp has no stubs
    """A Warp array of int32 or float64 on a device; on the CPU it shares contiguous memory."""
    kind = wp.int32 if values.dtype == np.int32 else wp.float64
    return wp.from_numpy(np.ascontiguousarray(values), dtype=kind, device=device)
