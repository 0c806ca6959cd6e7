"""Dry friction of MuJoCo, a soft constraint, from the times in which it stops a shaft."""

from __future__ import annotations

RIGID = 0.9999
"""Largest impedance of a constraint in MuJoCo."""


def constraint(stick_s: float, creep_s: float, shortest_s: float) -> tuple[float, float]:
    """Time constant and impedance of friction that stops a shaft in these times.

    Impedance d and time constant T of the constraint: ``stick = T d / 2``, ``creep = stick (1 - d)
    / d``. Source: MuJoCo's documentation, Computation, Constraint model (friction loss), where
    ``stick`` is 1 / b and b = 2 / (d T).

    Args:
        stick_s: Time in which friction stops the shaft, s; 0 for rigid friction.
        creep_s: Time constant of creep below the largest friction, s.
        shortest_s: Shortest time constant, two time steps of the simulation, s.

    Returns:
        Time constant in s, and impedance.
    """
    impedance = min(max(stick_s / max(stick_s + creep_s, 1e-12), 0.0001), RIGID)
    constant = max(2 * stick_s / impedance, shortest_s)
    return constant, impedance if stick_s else RIGID
