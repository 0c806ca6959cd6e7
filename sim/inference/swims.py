"""Pool recordings prepared for a fit, the noise of their poses, and simulations of them.

At 9 Hz and above poses hold only noise. White noise is equal at all frequencies; a filter's time
constant is estimated from them (Whittle's likelihood: J. R. Stat. Soc. B 15 (1953) 125).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter, savgol_filter
from tqdm import tqdm

from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.kernel import start_twin
from sim.twin.law import Coefficients
from sim.twin.twin import Twin
from sim2real.arrays import Array, Index
from sim2real.body import listed, observed, values
from sim2real.errors import InputError
from sim2real.model import FittedEffect, Model
from sim2real.plausible import validate_recording
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import context_of
from sim2real.velocity import body_velocity, turned

POSES = ("body.x_m", "body.y_m", "body.yaw_rad")
HELD_OUT_SHARE = 1 / 3
"""Share of a swim, at its end, that a calibration does not use."""
SUBSTEPS = 4
"""Sub-steps of a control period in a fit, half the twin's default: this changes a swim by 1 %, far
less than its error."""
SHORTEST_S = 1.0
"""Shortest swim that is fitted: a quarter is held out, and velocities take a fifth of a second."""
FLUID_THREADS = 2
"""CPU threads of the fluid."""
LAGS_S: Array = np.concatenate([[0.0], np.geomspace(0.004, 0.4, 60)])
"""Time constants of a filter of the poses that are compared."""
_REST = 10
"""Samples at the start whose mean is the first pose."""


@dataclass(frozen=True)
class PoseNoise:
    """Noise of x, y and heading."""

    sd: Array  # standard deviation before the filter, shape (3,)
    lag_s: float = 0.0  # time constant of the filter; 0 without a filter
    # log-likelihood ratio of each of ``LAGS_S`` to white noise; None where poses were resampled or
    # lost, which smooths them too
    colour: Array | None = None

    def log_ratio(self, lag_s: float) -> float:
        """Log-likelihood ratio of a filter with this time constant to white noise."""
        return 0.0 if self.colour is None else float(np.interp(lag_s, LAGS_S, self.colour))

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...], period_s: float) -> Array:
        """Random samples of this noise, shape (..., T, 3)."""
        white = rng.standard_normal((*shape, 3)) * self.sd
        weight = float(np.exp(-period_s / max(self.lag_s, 1e-9)))
        state = white[..., :1, :] * weight
        out, _ = lfilter([1 - weight], [1, -weight], white, axis=-2, zi=state)
        return np.asarray(out)


def pose_noise(poses: Array, period_s: float) -> PoseNoise | None:
    """Noise of poses (T, 3) at regular intervals, by third differences; None if they are few."""
    third = np.diff(poses, 3, axis=0)
    window = np.hanning(len(third))[:, None]
    hertz = np.fft.rfftfreq(len(third), period_s)
    high = hertz > 9.0
    if high.sum() < 64:
        return None
    angle = 2 * np.pi * period_s * hertz[high]
    power = np.abs(np.fft.rfft(third * window, axis=0)[high]) ** 2 / np.sum(window**2)
    flat = power / (2 * np.sin(angle / 2))[:, None] ** 6
    weight = np.exp(-period_s / np.maximum(LAGS_S, 1e-9))[:, None]
    response = (1 - weight) ** 2 / (1 + weight**2 - 2 * weight * np.cos(angle))
    square = np.mean(flat / response[:, :, None], axis=1)
    log_power = np.log(square).sum(axis=1) * angle.size + 3 * np.log(response).sum(axis=1)
    # the window correlates neighbouring frequencies: about two thirds are independent
    log_ratio = -2 / 3 * (log_power - log_power[0])
    # longer time constants than 0.05 s differ in the size of the noise only
    longest = np.searchsorted(LAGS_S, 0.05, side="right") - 1
    best = min(int(np.argmax(log_ratio)), int(longest)) if log_ratio.max() >= 5.0 else 0
    colour = np.clip(log_ratio, -60.0, 60.0)
    return PoseNoise(np.sqrt(square[best]), float(LAGS_S[best]), colour)


@dataclass(frozen=True, eq=False)
class Swim:
    """One pool recording on the grid of control periods."""

    name: str  # name of the recording
    t: Array  # times in s, shape (T,), every 20 ms
    command: Array  # set-points in force when each period begins, shape (T, J)
    start: Array  # first pose: x, y, heading
    # surge, sway, yaw rate and the joints' angles, shape (T, 3 + J); NaN where missing
    signals: Array
    pose: Array  # measured poses, shape (T, 3)
    # standard deviation of the recording's noise in each signal, shape (3 + J,)
    noise: Array | float = 0.0
    repeated: float = 0.0  # share of the poses that are identical to those of the sample before
    pose_noise: PoseNoise = PoseNoise(np.zeros(3))  # noise of the poses

    @property
    def heading(self) -> Array:
        """Measured heading, shape (T,), smoothed with the same filter as the velocities."""
        return np.asarray(savgol_filter(self.pose[:, 2], min(11, self.t.size), 2))

    @property
    def noise_sd(self) -> Array:
        """``noise`` of each signal, shape (3 + J,)."""
        return np.broadcast_to(self.noise, self.signals.shape[1])

    def first(self, share: float) -> Swim:
        """The first part of the swim."""
        n = round(self.t.size * share)
        names = ("t", "command", "signals", "pose")
        return replace(self, **{name: getattr(self, name)[:n] for name in names})


def signals_of_robot(robot: Robot) -> dict[str, tuple[str, str]]:
    """Name and unit of the 3 + J signals of a swim, by their names in models and diagnoses."""
    heads = {"surge": "m/s", "sway": "m/s", "yaw rate": "rad/s"}
    named = {f"body.{name.replace(' ', '_')}": (name, unit) for name, unit in heads.items()}
    return named | {f"{one.name}.position_rad": (one.name, "rad") for one in robot.joints}


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
    white = PoseNoise(_noise_sd(grid))
    noise = (known and pose_noise(grid, CONTROL_S)) or white
    if noise.lag_s == 0:
        noise = replace(noise, sd=white.sd)
    samples = noise.drawn(np.random.default_rng(0), (t.size,), CONTROL_S)
    return Swim(
        name=recording.name,
        t=t - t[0],
        command=np.nan_to_num(recording.command[row][:, order]),
        start=grid[:_REST].mean(axis=0),
        signals=np.concatenate([body_velocity(t, grid), joints], axis=1),
        pose=grid,
        noise=np.concatenate([body_velocity(t, samples).std(axis=0), _noise_sd(joints)]),
        repeated=repeated,
        pose_noise=noise,
    )


def _check(recording: Recording, robot: Robot) -> None:
    """Check that a recording is a swim of the robot, long enough for velocities."""
    validate_recording(recording, robot)
    where = recording.path or recording.name
    for joint in (joint.name for joint in robot.joints if joint.name not in recording.joints):
        found = ", ".join(recording.joints)
        raise InputError(recording.file, "joints", found, f"the robot's joint {joint} too")
    for name in (name for name in POSES if name not in recording.columns):
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


def simulated(swim: Swim, models: Sequence[Model], simulator: SwimSimulator) -> Array:
    """Signals of a swim for models with camera effects, (E, T, 3 + J), NaN after a stop."""
    return seen(swim.t, simulator(models, swim), [values(model) for model in models])


def seen(t: Array, track: Array, parameters: Sequence[Mapping[str, float]]) -> Array:
    """Signals of tracks (E, T, 3 + J) by a camera with these effects; NaN of a stopped robot."""
    out = np.full((len(track), t.size, track.shape[2]), np.nan)
    swam = np.flatnonzero(np.isfinite(track).all(axis=(1, 2)))
    if swam.size:
        poses = [observed(t, track[e, :, :3], parameters[int(e)]) for e in swam]
        out[swam, :, :3] = body_velocity(t, np.array(poses))
        out[swam, :, 3:] = track[swam, :, 3:]
    return out


def by_twin(robot: Robot, **options: Any) -> SwimSimulator:  # noqa: ANN401 - those of Twin
    """The reduced-order twin as a simulator, which other processes can take."""
    return partial(_in_twin, robot, options)


def _in_twin(robot: Robot, options: Any, models: Sequence[Model], swim: Swim) -> Array:  # noqa: ANN401
    """Tracks of models on a swim in the twin."""
    return Twin(robot, models, n_envs=len(models), **options).swum(swim.command, swim.start)


def by_fluid(robot: Robot, **options: Any) -> SwimSimulator:  # noqa: ANN401 - those of Swimmer
    """The lattice-Boltzmann fluid as a simulator, which other processes can take."""
    return partial(_in_fluid, robot, options)


def _in_fluid(robot: Robot, options: Any, models: Sequence[Model], swim: Swim) -> Array:  # noqa: ANN401
    """Tracks of models on a swim in the fluid."""
    swimmer = Swimmer(robot, models, n_envs=len(models), **options)
    return swum(swimmer, swim.command, swim.start)


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
        measured = uniform_filter1d(swim.pose, 5, axis=0)
        last = twin.track()
        angles, displacements = last[:, 3:], []
        commands = swim.command[:-1]
        for a, b in block_bounds(len(commands), CONTROL_S):
            if a:
                _carry(twin, measured[a])
                last = np.hstack([np.tile(measured[a], (len(models), 1)), last[:, 3:]])
            track = np.concatenate([last[:, None], twin.swim(commands[a:b])], axis=1)
            displacements.append(steps_of(track))
            last = track[:, -1]
        return path_of(np.concatenate(displacements, axis=1), swim.start, angles)

    return run


def block_bounds(samples: int, period_s: float) -> list[tuple[int, int]]:
    """First sample and end of each block of about 2.5 s."""
    count = max(1, round(samples * period_s / 2.5))
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
    law, known = dict(vars(Coefficients.of(body))), values(model)
    for name, value in parameters.items():
        head, _, tail = name.partition(".")
        effect, _, parameter = tail.rpartition(".")
        if head in joints:
            servo, changed = joints[head], dict[str, Any]({tail: value})
            if effect:
                effects = {one.effect: dict(one.parameters) for one in servo.effects}
                own = effects.setdefault(effect, {})
                own[parameter] = own.get(parameter, 0.0) + value
                changed = {"effects": tuple(FittedEffect(*one) for one in effects.items())}
            joints[head] = replace(servo, **changed)
        elif head == "twin":
            law[tail] = value
        elif head == "water":
            body["water"] = {**body.get("water", {}), tail: value}
        else:
            known[name] = value
    if any(name.startswith("twin.") for name in parameters) or "twin" in body:
        body["twin"] = law
    body["effects"] = listed(known)
    return replace(model, joints=joints, body=body)


def values_of(model: Model, names: Sequence[str]) -> Array:
    """Values by name, as ``with_values`` takes them; 0 where the model has no such effect."""
    parts = {name: vars(joint) for name, joint in model.joints.items()}
    parts |= {name: model.body.get(name, {}) for name in ("twin", "water")}
    known = values(model)
    for head, part in parts.items():
        known |= {f"{head}.{tail}": value for tail, value in part.items()}
    return np.array([float(known.get(name, 0.0)) for name in names])
