"""Kernels at the start of a control period: send set-points, bring boxes to rest."""

from functools import cache
from typing import Any

import warp as wp

from sim.lattice.cell import BODY, GHOST, Box
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice
from sim.robot.chain import RING, Chain, Motion
from sim2real.servo.effect_chain import arrival_time


@wp.kernel(enable_backward=False)
def send(
    command: wp.array2d(dtype=wp.float64),
    chain: Chain,
    s: Motion,
    stopped: wp.array(dtype=wp.int32),
):
    """Send a set-point to joint k of robot e."""
    e, k = wp.tid()
    if stopped[e] >= 0:
        return
    number = s.newest[e, k] + 1
    slot = number % wp.static(RING)
    zero = wp.float64(0.0)
    p = chain.servo[e, k]
    now = s.clock[e]
    arrives = now + p[2]
    if chain.active[e, k] != wp.int64(0):
        arrives = arrival_time(
            arrives, wp.float64(number), zero, zero, now, zero, p, chain.memory[e, k],
            chain.active[e, k],
        )  # fmt: skip
    s.sent[e, k, slot] = command[e, k] + chain.trim[e, k]
    s.arrival[e, k, slot] = arrives
    s.newest[e, k] = number


@wp.kernel(enable_backward=False)
def remember(mask: wp.array(dtype=wp.int32), chain: Chain, s: Motion):
    """Reset the clock of robot e, with its angles as the set-points in force."""
    e = wp.tid()
    if mask[e] == 0:
        return
    s.clock[e] = wp.float64(0.0)
    for k in range(s.newest.shape[1]):
        s.newest[e, k] = 0
        s.sent[e, k, 0] = s.q[e, 3 + k]
        s.arrival[e, k, 0] = wp.float64(-1.0)
        s.torque[e, k] = wp.float64(0.0)
        s.measured[e, k] = s.q[e, 3 + k] - chain.trim[e, k]
        s.strain[e, k] = s.q[e, 3 + k]
        for i in range(chain.memory.shape[2]):
            chain.memory[e, k, i] = wp.float64(0.0)


@cache
def calm(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that brings boxes to rest."""
    pop = populations(lattice, wide)
    Stored, write = pop.Stored, pop.write

    @wp.kernel(enable_backward=False, module="unique")
    def calm(
        mask: wp.array(dtype=wp.int32),
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        stopped: wp.array(dtype=wp.int32),
    ):
        e, n = wp.tid()
        if mask[e] == 0:
            return
        cell = e * box.cells + n
        for d in range(wp.static(lattice.Q)):
            write(f, d, cell, box.total, 0.0)
        flags[cell] = wp.uint8(int(flags[cell]) & wp.static(~(BODY | GHOST) & 255))
        if n == 0:
            stopped[e] = -1

    return calm
