"""Motion of an arm, and the load that it exerts on each shaft.

Coupled rollout: waveform relaxation. Each servo is simulated over the whole time under the load
that the other joints' motions of the last iteration exert, until no motion changes. Lelarasmee,
Ruehli, Sangiovanni-Vincentelli, IEEE Transactions on Computer-Aided Design 1 (1982) 131-145.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arm.description import Arm, Multibody
from sim2real.arrays import Array
from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.model import JointModel, Model
from sim2real.recording import Recording, VaryingLoad
from sim2real.robot import Robot
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    FIRST_COLUMN,
    INERTIA_LEFT_OUT,
    ROTOR_INERTIA,
    in_context,
    joint_row,
)
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import context_of

STEP_S = 0.002
"""Time between the values of a motion."""
_LOAD = slice(BASE.index("inertia_kgm2"), BASE.index("gravity_Nm") + 1)
_GAP = FIRST_COLUMN["backlash"]
_SENSOR = np.isin(
    [name.partition(".")[0] for name in COLUMNS], [e.name for e in CATALOGUE if e.site == "sensor"]
)
"""Which columns are those of effects of the sensor."""


@dataclass(frozen=True)
class ArmMotion:
    """Angles of J joints in rad, shape (K, J), every ``STEP_S`` from ``start_s``."""

    start_s: float
    angle: Array

    @property
    def t(self) -> Array:
        """Times in s, shape (K,)."""
        return np.asarray(self.start_s + STEP_S * np.arange(len(self.angle)))

    @property
    def velocity(self) -> Array:
        """Speeds in rad/s by central differences, shape (K, J)."""
        return np.asarray(np.gradient(self.angle, STEP_S, axis=0))

    @property
    def acceleration(self) -> Array:
        """Accelerations in rad/s2 by second differences, 0 at the ends, shape (K, J).

        Their integral between two times is the change of speed, also across a jump.
        """
        out = np.zeros_like(self.angle)
        out[1:-1] = np.diff(self.angle, 2, axis=0) / STEP_S**2
        return out


def with_arm_loads(
    recordings: Sequence[Recording], robot: Robot, model: Model | None = None
) -> list[Recording]:
    """The recordings, with loads that vary with time if the robot is an arm.

    The prediction of fitted servos supplies the fast part of the motion; without a model the motion
    is that of smoothed measured angles.

    Raises:
        InputError: If a recording states loads besides the URDF, or the URDF is not usable.
    """
    if robot.arm is None:
        return list(recordings)
    multibody, names, out = Multibody(robot.arm), robot.arm.names, []
    for recording in recordings:
        for name in names:
            if name in recording.loads:
                found = f"a load of {name}, which the URDF in {robot.path} has as well"
                raise InputError(recording.file, f"loads.{name}", found, "one of the two")
        if model is None:
            motion = measured_motion(recording, robot.arm)
        else:
            commands = {name: x for name, x in recording.commands.items() if name in names}
            context = context_of(recording)
            joints = {name: in_context(joint, **context) for name, joint in model.joints.items()}
            predicted, _ = predicted_arm(multibody, joints, recording.t, commands)
            motion = _corrected(predicted, recording, names)
        loads = zip(names, _loads_on(multibody, motion), strict=True)
        varying = {name: load for name, load in loads if name in recording.joints}
        out.append(replace(recording, varying_loads=varying))
    return out


def predicted_arm(
    multibody: Multibody, joints: Mapping[str, JointModel], t: Array, command: Mapping[str, Array]
) -> tuple[ArmMotion, dict[str, Array]]:
    """Motion and measured angles of an arm that a model predicts from commands alone.

    Joints that are not in the model follow their command; without a command they stay at the URDF's
    zero. Times (T,) are in s, set-points of joints (T,) in rad.

    Returns:
        The motion of all joints, and the angles in rad of the commanded ones, each of shape (T,).

    Raises:
        InputError: If the simulation does not converge.
    """
    arm = multibody.arm
    rows: list[Array | None] = []
    sent = np.empty((t.size, len(arm.joints)))
    for j, joint in enumerate(arm.joints):
        fitted = joints.get(joint.name) if joint.name in command else None
        rows.append(None if fitted is None else joint_row(fitted, None, f"model, {joint.name}"))
        sent[:, j] = command.get(joint.name, np.full(t.size, joint.zero_rad))
    motion, angles = _coupled(multibody, rows, t, sent)
    by_name = dict(zip(arm.names, angles.T, strict=True))
    return motion, {name: by_name[name] for name in command}


def measured_motion(recording: Recording, arm: Arm, *, cutoff_hz: float = 10.0) -> ArmMotion:
    """Motion of an arm's joints from measured angles alone, smoothed without phase shift.

    Joints that were not recorded rest at the URDF's zero.
    """
    t = _grid(recording.t)
    angle = np.tile([joint.zero_rad for joint in arm.joints], (t.size, 1))
    for j, joint in enumerate(arm.joints):
        if joint.name in recording.joints:
            measured = recording.position[:, recording.joints.index(joint.name)]
            angle[:, j] = _interpolated(t, recording.t, measured, joint.zero_rad)
    return ArmMotion(float(t[0]), _low_pass(angle, cutoff_hz))


def _corrected(
    predicted: ArmMotion, recording: Recording, names: Sequence[str], *, cutoff_hz: float = 4.0
) -> ArmMotion:
    """A prediction, whose fast motion samples do not resolve, less its slow error."""
    t, error = predicted.t, np.zeros_like(predicted.angle)
    for j, name in enumerate(names):
        if name in recording.joints:
            measured = recording.position[:, recording.joints.index(name)]
            at_samples = np.interp(recording.t, t, predicted.angle[:, j])
            error[:, j] = _interpolated(t, recording.t, measured - at_samples, 0.0)
    return replace(predicted, angle=predicted.angle + _low_pass(error, cutoff_hz))


def _loads_on(multibody: Multibody, motion: ArmMotion) -> list[VaryingLoad]:
    """The load on each of J shafts while the arm moves."""
    inertia, torque = multibody.loads(motion.angle, motion.velocity, motion.acceleration)
    pairs = zip(inertia.T, torque.T, strict=True)
    return [VaryingLoad(motion.start_s, STEP_S, of_j, torque_j) for of_j, torque_j in pairs]


def _coupled(
    multibody: Multibody,
    rows: Sequence[Array | None],
    t: Array,
    command: Array,
    *,
    iterations: int = 80,
) -> tuple[ArmMotion, Array]:
    """Motion of the shafts, and measured angles (T, J), from rest on the first commands (T, J)."""
    fine = _grid(t)
    times = np.unique(np.concatenate([t, fine]))
    held = command[np.searchsorted(t, times, side="right") - 1]
    on_grid, at_samples = np.searchsorted(times, fine), np.searchsorted(times, t)
    followed = _without_gaps(held[on_grid])
    free = [j for j, row in enumerate(rows) if row is not None]
    if free:
        followed[:, free] = _low_pass(followed[:, free], 3.0)  # a first guess
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
    tolerance = 3e-4 if play else 1e-5
    # servos whose measured angles are those of their output shafts
    shafts = [None if row is None else np.where(_SENSOR, 0.0, row) for row in rows]
    largest = np.inf

    def converged(motion: ArmMotion, cutoff_hz: float | None) -> ArmMotion | None:
        nonlocal largest
        for _ in range(iterations):
            angle = all_joints(shafts, _loads_on(multibody, motion))[on_grid]
            if cutoff_hz is not None:
                angle[:, free] = _low_pass(angle[:, free], cutoff_hz)
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
    with ThreadPoolExecutor(2) as pool:
        for cutoff_hz in (20.0, 40.0, 80.0, 160.0) if play else (None,):  # of impacts
            finer = converged(best or motion, cutoff_hz)
            if finer is None:
                break
            best = finer
        if best is not None:
            return best, all_joints(rows, _loads_on(multibody, best))[at_samples]
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


def _relaxation(
    multibody: Multibody, rows: Sequence[Array | None], angle: Array, *, poses: int = 50
) -> float:
    """Weight of a new iterate that makes the iteration converge fastest.

    Jacobi's on the mass matrix with rotors: 2 / (smallest + largest eigenvalue) of the matrix
    scaled to a unit diagonal. Saad, Iterative Methods for Sparse Linear Systems (SIAM, 2003), Sec.
    4.2.1.
    """
    some = angle[:: max(1, len(angle) // poses)]
    mass = multibody.mass_matrix(some)
    free = [j for j, row in enumerate(rows) if row is not None]
    for j, row in enumerate(rows):  # with play the rotor does not turn with the link
        if row is not None and not row[_GAP] > 0:
            mass[:, j, j] += row[ROTOR_INERTIA] + row[INERTIA_LEFT_OUT]
    mass = mass[:, free][:, :, free]
    scale = 1 / np.sqrt(np.einsum("kjj->kj", mass))
    eigenvalues = np.linalg.eigvalsh(scale[:, :, None] * mass * scale[:, None])
    return float(2 / (eigenvalues.min() + eigenvalues.max()))


def _grid(t: Array) -> Array:
    """Evenly spaced times from the first of ``t`` to its last or just beyond, at least two."""
    count = max(2, int(np.ceil((t[-1] - t[0]) / STEP_S - 1e-9)) + 1)
    return np.asarray(t[0] + STEP_S * np.arange(count))


def _low_pass(values: Array, cutoff_hz: float, *, order: int = 4) -> Array:
    """Values (K, J) filtered forwards and backwards by a Butterworth filter; constant beyond."""
    from scipy.signal import butter, sosfiltfilt  # takes half a second to load

    filtered = butter(order, cutoff_hz, fs=1 / STEP_S, output="sos")
    ends = min(len(values) - 1, int(2 / (cutoff_hz * STEP_S)))
    return np.asarray(sosfiltfilt(filtered, values, axis=0, padtype="constant", padlen=ends))


def _interpolated(t: Array, samples: Array, values: Array, otherwise: float) -> Array:
    """Values at times ``t`` by a cubic spline through those present; constant beyond the ends."""
    from scipy.interpolate import CubicSpline  # slow to load

    present = np.isfinite(values)
    if present.sum() < 2:
        return np.full(t.size, float(values[present][0]) if present.any() else otherwise)
    first, last = samples[present][[0, -1]]
    spline = CubicSpline(samples[present], values[present])
    return np.asarray(spline(np.clip(t, first, last)))
