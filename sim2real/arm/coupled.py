"""Coupled rollout of an arm: all servos' laws and the arm's equations of motion together.

Waveform relaxation: each servo is simulated over the whole time under the load that the other
joints' motions of the last iteration exert, until no motion changes. Lelarasmee, Ruehli,
Sangiovanni-Vincentelli, IEEE Transactions on Computer-Aided Design 1 (1982) 131-145.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sim2real.arm.joint_motion import STEP_S, ArmMotion, grid, low_pass
from sim2real.arm.multibody import Multibody
from sim2real.arrays import Array
from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.recording import VaryingLoad
from sim2real.servo.parameters import BASE, FIRST_COLUMN, INERTIA_LEFT_OUT, ROTOR_INERTIA
from sim2real.servo.rollout import rollout

_LOAD = slice(BASE.index("inertia_kgm2"), BASE.index("gravity_Nm") + 1)
_GAP = FIRST_COLUMN["backlash"]


def loads_on(multibody: Multibody, motion: ArmMotion) -> list[VaryingLoad]:
    """The load on each of J shafts while the arm moves."""
    inertia, torque = multibody.loads(motion.angle, motion.velocity, motion.acceleration)
    return [
        VaryingLoad(motion.start_s, motion.step_s, inertia[:, j], torque[:, j])
        for j in range(inertia.shape[1])
    ]


def coupled_motion(
    multibody: Multibody,
    rows: Sequence[Array | None],
    t: Array,
    command: Array,
    *,
    tolerance_rad: float = 1e-5,
    impact_tolerance_rad: float = 3e-4,
    impact_cutoffs_hz: Sequence[float] = (20.0, 40.0, 80.0, 160.0),
    iterations: int = 80,
    threads: int = 2,
) -> tuple[ArmMotion, Array]:
    """Simulate an arm from rest on its first commands.

    With play, the flanks of one joint's gears hit one another a little earlier or later in every
    iteration. The others then see its motion without frequencies above a cut-off, which is raised
    as long as the iteration converges.

    Args:
        multibody: Dynamics of the arm, with J joints.
        rows: Parameters of each servo, shape (P,), or None where the joint follows its command.
        t: Times of commands and samples in s, shape (T,).
        command: Set-points in rad, shape (T, J).
        tolerance_rad: Change of an angle between iterations at which they end.
        impact_tolerance_rad: The same where a servo has play.
        impact_cutoffs_hz: Cut-off frequencies of motions where a servo has play, ascending.
        iterations: Largest number of iterations, of each cut-off.
        threads: CPU threads.

    Returns:
        The motion of the shafts, and the measured angles in rad at ``t``, shape (T, J).

    Raises:
        InputError: If the iteration does not converge, with play that of the lowest cut-off.
    """
    fine = grid(t)
    times = np.unique(np.concatenate([t, fine]))
    held = command[np.searchsorted(t, times, side="right") - 1]
    on_grid, at_samples = np.searchsorted(times, fine), np.searchsorted(times, t)
    followed = _without_gaps(held[on_grid])
    free = [j for j, row in enumerate(rows) if row is not None]
    if free:
        followed[:, free] = low_pass(followed[:, free], STEP_S, 3.0)  # a first guess
    motion = ArmMotion(float(fine[0]), followed)
    weight = _relaxation(multibody, rows, motion.angle)

    def simulated(row: Array, j: int, load: VaryingLoad) -> Array:
        loaded = row.copy()
        loaded[_LOAD] = load.mean_inertia_kgm2, 0.0
        return np.asarray(rollout(loaded[None], times, held[:, j], varying=load)[0])

    def all_joints(servos: Sequence[Array | None], loads: Sequence[VaryingLoad]) -> Array:
        def angles(j: int) -> Array:
            row = servos[j]
            return held[:, j] if row is None else simulated(row, j, loads[j])

        return np.stack(list(pool.map(angles, range(len(servos)))), axis=1)

    play = any(row is not None and row[_GAP] > 0 for row in rows)
    tolerance = impact_tolerance_rad if play else tolerance_rad
    shafts = [None if row is None else _without_sensor(row) for row in rows]
    largest = np.inf

    def converged(motion: ArmMotion, cutoff_hz: float | None) -> ArmMotion | None:
        nonlocal largest
        for _ in range(iterations):
            angle = all_joints(shafts, loads_on(multibody, motion))[on_grid]
            if cutoff_hz is not None:
                angle[:, free] = low_pass(angle[:, free], STEP_S, cutoff_hz)
            change = angle - motion.angle
            change[:, [j for j, row in enumerate(rows) if row is None]] = 0.0
            largest = float(np.abs(change).max())
            if largest < tolerance:
                return motion
            if not np.isfinite(largest):
                break
            motion = ArmMotion(motion.start_s, motion.angle + weight * change)
        return None

    best = None
    with ThreadPoolExecutor(threads) as pool:
        for cutoff_hz in impact_cutoffs_hz if play else (None,):
            finer = converged(best or motion, cutoff_hz)
            if finer is None:
                break
            best = finer
        if best is not None:
            return best, all_joints(rows, loads_on(multibody, best))[at_samples]
    found = f"motions that still change by {largest:.2g} rad after {iterations} iterations"
    raise InputError("model", "arm", found, "servos that hold the arm in every joint")


def _without_gaps(command: Array) -> Array:
    """Commands (K, J), each held where its torque is off."""
    out = command.copy()
    for j in range(out.shape[1]):
        present = np.flatnonzero(np.isfinite(out[:, j]))
        last = present[np.searchsorted(present, np.arange(len(out)), side="right") - 1]
        out[:, j] = out[last, j]
    return out


def _without_sensor(row: Array) -> Array:
    """A servo's parameters (P,) whose measured angle is that of the output shaft."""
    out = row.copy()
    for effect in CATALOGUE:
        if effect.site == "sensor":
            first = FIRST_COLUMN[effect.name]
            out[first : first + len(effect.parameters)] = 0.0
    return out


def _rotor(row: Array) -> float:
    """Inertia that turns with a link besides it; with play the rotor does not."""
    return 0.0 if row[_GAP] > 0 else float(row[ROTOR_INERTIA] + row[INERTIA_LEFT_OUT])


def _relaxation(
    multibody: Multibody, rows: Sequence[Array | None], angle: Array, *, poses: int = 50
) -> float:
    """Weight of a new iterate that makes the iteration converge fastest.

    The iteration is Jacobi's on the mass matrix, with the inertia of each rotor on its diagonal. It
    is optimal for 2 / (smallest + largest eigenvalue) of the matrix scaled to a unit diagonal, over
    some poses. Saad, Iterative Methods for Sparse Linear Systems (SIAM, 2003), Sec. 4.2.1.
    """
    some = angle[:: max(1, len(angle) // poses)]
    mass = multibody.mass_matrix(some)
    mass += np.diag([0.0 if row is None else _rotor(row) for row in rows])
    free = [j for j, row in enumerate(rows) if row is not None]
    mass = mass[:, free][:, :, free]
    scale = 1 / np.sqrt(np.einsum("kjj->kj", mass))
    eigenvalues = np.linalg.eigvalsh(scale[:, :, None] * mass * scale[:, None])
    return float(2 / (eigenvalues.min() + eigenvalues.max()))
