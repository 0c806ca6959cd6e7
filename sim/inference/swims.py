"""Pool recordings prepared for a fit, and their simulation in the twin and in the fluid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter
from tqdm import tqdm

from sim.inference.pose_noise import PoseNoise, pose_noise
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.kernel import start_twin
from sim.twin.law import Coefficients
from sim.twin.twin import Twin
from sim2real.arrays import Array, Index
from sim2real.body import listed, observed, values
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.plausible import validate_recording
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import context_of
from sim2real.velocity import body_velocity, turned

SIGNALS = {"surge": "m/s", "sway": "m/s", "yaw rate": "rad/s"}
"""Velocities of the head, and their units."""
POSES = ("body.x_m", "body.y_m", "body.yaw_rad")
HELD_OUT_SHARE = 1 / 3
"""Share of a swim, at its end, that a calibration does not use."""
SUBSTEPS = 4
"""Sub-steps of a control period in a fit, half the twin's default: this changes a swim by 1 %, far
less than its error."""
SHORTEST_S = 1.0
"""Shortest swim that is fitted: a quarter is held out, and velocities take a fifth of a second."""
BLOCK_S = 2.5
FLUID_THREADS = 2
"""CPU threads of the fluid."""
_REST = 10
"""Samples at the start whose mean is the first pose."""

Simulator = Callable[[Sequence[Model], Array, Array], Array]
"""From models (E), commands (T, J) and a first pose to tracks (E, T, 3 + J)."""


@dataclass(frozen=True, eq=False)
class Swim:
    """One pool recording on the grid of control periods."""

    name: str  # name of the recording
    t: Array  # times in s, shape (T,), every 20 ms
    command: Array  # set-points in force when each period begins, shape (T, J)
    start: Array  # first pose: x, y, heading
    # surge, sway, yaw rate and the joints' angles, shape (T, 3 + J); NaN where missing
    signals: Array
    # standard deviation of the recording's noise in each signal, shape (3 + J,); 0 where it is not
    # known
    noise: Array | float = 0.0
    pose: Array | None = None  # measured poses, shape (T, 3); None if they are not known
    repeated: float = 0.0  # share of the poses that are identical to those of the sample before
    pose_noise: PoseNoise | None = None  # noise of the poses; None where it is not known

    @property
    def heading(self) -> Array:
        """Measured heading, shape (T,), smoothed with the same filter as the velocities."""
        if self.pose is None:
            turned = np.cumsum(self.signals[:, 2]) * CONTROL_S
            return np.asarray(self.start[2] + turned - turned[0])
        return np.asarray(savgol_filter(self.pose[:, 2], min(11, self.t.size), 2))

    @property
    def noise_sd(self) -> Array:
        """``noise`` of each signal, shape (3 + J,)."""
        return np.broadcast_to(self.noise, self.signals.shape[1])

    def first(self, share: float) -> Swim:
        """The first part of the swim."""
        n = round(self.t.size * share)
        pose = None if self.pose is None else self.pose[:n]
        return replace(
            self, t=self.t[:n], command=self.command[:n], signals=self.signals[:n], pose=pose
        )


def units_of(robot: Robot) -> dict[str, str]:
    """Names of the 3 + J signals of a swim, with their units."""
    return SIGNALS | {joint.name: "rad" for joint in robot.joints}


def names_in_files(robot: Robot) -> list[str]:
    """Names of the 3 + J signals of a swim in models and diagnoses."""
    heads = [f"body.{name.replace(' ', '_')}" for name in SIGNALS]
    return heads + [f"{joint.name}.position_rad" for joint in robot.joints]


SwimSimulator = Callable[[Sequence[Model], Swim], Array]
"""From models (E) and a swim to tracks (E, T, 3 + J)."""


def swim_of(recording: Recording, robot: Robot) -> Swim:
    """A recording, resampled to the control period where its sampling is irregular."""
    _check(recording, robot)
    t = np.arange(recording.t[0], recording.t[-1] + CONTROL_S / 2, CONTROL_S)
    row = np.searchsorted(recording.t, t + 1e-6, side="right") - 1
    order = [recording.joints.index(joint.name) for joint in robot.joints]

    def resampled(columns: Array, delay_s: float = 0.0) -> Array:
        out = np.full((t.size, columns.shape[1]), np.nan)
        for k, column in enumerate(columns.T):
            finite = np.isfinite(column)
            if finite.sum() >= _REST:
                out[:, k] = np.interp(t, recording.t[finite] + delay_s, column[finite])
        return out

    pose = np.stack([recording.columns[name] for name in POSES], axis=1)
    pose[:, 2] = np.where(np.isfinite(pose[:, 2]), np.unwrap(np.nan_to_num(pose[:, 2])), np.nan)
    grid = resampled(pose)
    joints = resampled(recording.position[:, order], context_of(recording)["sample_delay_s"])
    same = np.all(np.diff(pose[np.isfinite(pose).all(axis=1)], axis=0) == 0, axis=1)
    repeated = float(same.mean()) if same.size else 0.0
    regular = len(recording.t) == t.size and np.allclose(recording.t, t, atol=1e-4)
    # the spectrum of the noise is known only where no pose was resampled or lost
    known = regular and np.isfinite(pose).all() and repeated == 0.0
    noise = pose_noise(grid, CONTROL_S) if known else None
    if noise is None or noise.lag_s == 0:
        noise = PoseNoise(_noise_sd(grid), 0.0, None if noise is None else noise.colour)
    samples = noise.drawn(np.random.default_rng(0), (t.size,), CONTROL_S)
    return Swim(
        name=recording.name,
        t=t - t[0],
        command=np.nan_to_num(recording.command[row][:, order]),
        start=grid[:_REST].mean(axis=0),
        signals=np.concatenate([body_velocity(t, grid), joints], axis=1),
        noise=np.concatenate([body_velocity(t, samples).std(axis=0), _noise_sd(joints)]),
        pose=grid,
        repeated=repeated,
        pose_noise=noise,
    )


def _check(recording: Recording, robot: Robot) -> None:
    """Check that a recording is a swim of the robot, long enough for velocities."""
    validate_recording(recording, robot)
    where = recording.path or recording.name
    for joint in robot.joints:
        if joint.name not in recording.joints:
            found, expected = ", ".join(recording.joints), f"the robot's joint {joint.name} too"
            raise InputError(recording.file, "joints", found, expected)
    for name in POSES:
        if name not in recording.columns:
            raise InputError(where, name, "no such column", "poses of the body, in a pool")
    if np.isnan(recording.command).all():
        raise InputError(where, "header", "no J.command_rad column", "the set-points sent")
    if recording.duration_s < SHORTEST_S:
        found, expected = f"{recording.duration_s:.3g} s", f"a swim of at least {SHORTEST_S:g} s"
        raise InputError(recording.file, "t_s", found, expected)
    for name in POSES:
        count = int(np.isfinite(recording.columns[name]).sum())
        if count < _REST:
            raise InputError(recording.file, name, f"{count} values", f"at least {_REST}")


def _noise_sd(signals: Array) -> Array:
    """Standard deviation of the noise of smooth signals (T, K), from third differences, (K,)."""
    third = np.abs(np.diff(signals, 3, axis=0))  # of white noise: 20 times its variance
    return np.asarray(np.nan_to_num(np.nanmedian(third, axis=0) / 0.6745 / np.sqrt(20)))


def simulated(swim: Swim, models: Sequence[Model], simulator: Simulator) -> Array:
    """Signals of a swim for models with camera effects, (E, T, 3 + J), NaN after a stop."""
    track = simulator(models, swim.command, swim.start)
    return seen(swim.t, track, [values(model) for model in models])


def seen(t: Array, track: Array, parameters: Sequence[Mapping[str, float]]) -> Array:
    """Signals of tracks (E, T, 3 + J) by a camera with these effects; NaN of a stopped robot."""
    out = np.full((len(track), t.size, track.shape[2]), np.nan)
    swam = np.flatnonzero(np.isfinite(track).all(axis=(1, 2)))
    if swam.size:
        poses = [observed(t, track[e, :, :3], parameters[int(e)]) for e in swam]
        out[swam, :, :3] = body_velocity(t, np.array(poses))
        out[swam, :, 3:] = track[swam, :, 3:]
    return out


def by_twin(robot: Robot, **options: Any) -> Simulator:  # noqa: ANN401 - those of Twin
    """The reduced-order twin as a simulator."""

    def run(models: Sequence[Model], command: Array, start: Array) -> Array:
        twin = Twin(robot, models, n_envs=len(models), **options)
        twin.reset(pose=start)
        first = twin.track()
        return np.concatenate([first[:, None], twin.swim(command[:-1])], axis=1)

    return run


def of_swims(simulator: Simulator) -> SwimSimulator:
    """A simulator of swims from their first pose."""
    return lambda models, swim: simulator(models, swim.command, swim.start)


def by_fluid(robot: Robot, **options: Any) -> Simulator:  # noqa: ANN401 - those of Swimmer
    """The lattice-Boltzmann fluid as a simulator."""

    def run(models: Sequence[Model], command: Array, start: Array) -> Array:
        return swum(Swimmer(robot, models, n_envs=len(models), **options), command, start)

    return run


def swum(swimmer: Swimmer, commands: Array, start: Array) -> Array:
    """Tracks (E, T, 3 + J) in the fluid, by set-points for all (T, J), or for each (T, E, J)."""
    swimmer.reset(pose=start)
    track = [swimmer.track()]
    for sent in tqdm(commands[:-1], desc="fluid", unit="step", disable=None, leave=False):
        swimmer.step(sent)
        track.append(swimmer.track())
    return np.moveaxis(np.array(track), 0, 1)


def by_followed_twin(robot: Robot, **settings: Any) -> SwimSimulator:  # noqa: ANN401 - options of Twin
    """The twin, moved to the measured pose every few seconds, with its velocity in the body frame.

    Cable and wall act at places, and the path of a free simulation soon differs from the measured
    one. The track is integrated from the displacements of all periods and has no jumps.
    """
    options = {"substeps": SUBSTEPS, **settings}

    def run(models: Sequence[Model], swim: Swim) -> Array:
        twin = Twin(robot, models, n_envs=len(models), **options)
        twin.reset(pose=swim.start)
        measured = swim.start[None] if swim.pose is None else uniform_filter1d(swim.pose, 5, axis=0)
        last = twin.track()
        angles, displacements = last[:, 3:], []
        commands = swim.command[:-1]
        for a, b in block_bounds(len(commands), CONTROL_S):
            if a and swim.pose is not None:
                _carry(twin, measured[a])
                last = np.hstack([np.tile(measured[a], (len(models), 1)), last[:, 3:]])
            track = np.concatenate([last[:, None], twin.swim(commands[a:b])], axis=1)
            displacements.append(steps_of(track))
            last = track[:, -1]
        return path_of(np.concatenate(displacements, axis=1), swim.start, angles)

    return run


def block_bounds(samples: int, period_s: float) -> list[tuple[int, int]]:
    """First sample and end of each block of about ``BLOCK_S``."""
    count = max(1, round(samples * period_s / BLOCK_S))
    edges = np.linspace(0, samples, count + 1).round().astype(int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _carry(twin: Twin, pose: Array) -> None:
    """Move robots and their wake to a pose in the pool; velocities in the body frame are kept."""
    clock = np.array(twin.motion.clock.numpy())
    q, v = np.array(twin.motion.q.numpy()), np.array(twin.motion.v.numpy())
    turn = pose[2] - q[:, 2]
    v[:, :2] = turned(v[:, :2], turn)
    q[:, :2] = pose[:2] - twin.current * clock[:, None]
    q[:, 2] = pose[2]
    twin.motion.q.assign(q)
    twin.motion.v.assign(v)
    twin.water.moved.assign(turned(np.array(twin.water.moved.numpy()), turn[:, None]))
    everyone: Any = wp.ones(twin.n_envs, dtype=wp.int32, device=twin.device)
    inputs = [twin.chain, twin.motion, twin.water, everyone]
    wp.launch(start_twin, dim=twin.n_envs, inputs=inputs, device=twin.device)


def steps_of(track: Array) -> Array:
    """Displacements forward, to the left, of the heading, and joint angles: (E, T - 1, 3 + J)."""
    change = np.diff(track[..., :3], axis=1)
    moved = turned(change[..., :2], -track[:, :-1, 2])
    return np.concatenate([moved, change[..., 2:], track[:, 1:, 3:]], axis=2)


def path_of(steps: Array, start: Array, joint: Array) -> Array:
    """The path from a first pose, the inverse of ``steps_of``."""
    E = len(steps)
    heading = start[2] + np.cumsum(np.pad(steps[..., 2], ((0, 0), (1, 0))), axis=1)
    moved = np.cumsum(turned(steps[..., :2], heading[:, :-1]), axis=1)
    place = start[:2] + np.concatenate([np.zeros((E, 1, 2)), moved], axis=1)
    first = np.broadcast_to(joint, (E, joint.shape[-1]))[:, None]
    angles = np.concatenate([first, steps[..., 3:]], axis=1)
    return np.concatenate([place, heading[..., None], angles], axis=2)


def distinct(models: Sequence[Model]) -> tuple[list[Model], Index]:
    """Models (U) without repetitions, and the place of each of the E models among them, (E,)."""
    texts = [repr(model) for model in models]
    _, first, place = np.unique(texts, return_index=True, return_inverse=True)
    return [models[k] for k in first], place


def with_values(model: Model, parameters: Mapping[str, float]) -> Model:
    """The model with values by name: of joints (``j1.kp_Nm_per_rad``), twin, water, effects.

    Sizes of a servo's effects (``j1.coulomb_friction.torque_Nm``) are added to those it has.
    """
    joints, body = dict(model.joints), dict(model.body)
    law = dict(vars(Coefficients.of(body)))
    effects = values(model)
    for name, value in parameters.items():
        head, _, tail = name.partition(".")
        if head in joints:
            joints[head] = _with_value(joints[head], tail, value)
        elif head == "twin":
            law[tail] = value
        elif head == "water":
            body["water"] = {**body.get("water", {}), tail: value}
        else:
            effects[name] = value
    if any(name.startswith("twin.") for name in parameters) or "twin" in body:
        body["twin"] = law
    body["effects"] = listed(effects)
    return replace(model, joints=joints, body=body)


def _with_value(servo: JointModel, name: str, value: float) -> JointModel:
    """A servo with a value of its own, or of an effect (``EFFECT.NAME``) besides what it has."""
    effect, _, parameter = name.rpartition(".")
    if not effect:
        changed: dict[str, Any] = {name: value}
        return replace(servo, **changed)
    effects = {one.effect: dict(one.parameters) for one in servo.effects}
    known = effects.setdefault(effect, {})
    known[parameter] = known.get(parameter, 0.0) + value
    return replace(servo, effects=tuple(FittedEffect(*item) for item in effects.items()))
