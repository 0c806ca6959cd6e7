"""Pool recordings prepared for a fit, the noise of their poses, and their simulation.

At 9 Hz and above the poses hold only noise, as a robot does not move that fast. White noise is
equal at all frequencies; a filter of the poses smooths their noise too, so its time constant is
estimated from these frequencies (Whittle's likelihood: J. R. Stat. Soc. B 15 (1953) 125).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter, savgol_filter
from tqdm import tqdm

from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.twin import Coefficients, Twin
from sim2real.arrays import Array
from sim2real.body import listed, observed, values
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.plausible import validate_recording
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import context_of
from sim2real.velocity import body_velocity

SIGNALS = ("surge", "sway", "yaw rate")
UNITS = ("m/s", "m/s", "rad/s")
_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal variable."""
_REST = 10
"""Samples at the start whose mean is the first pose."""
SHORTEST_S = 1.0
"""Shortest swim that is fitted: a quarter is held out, and velocities take a fifth of a second."""

ABOVE_HZ = 9.0
LAGS_S: Array = np.concatenate([[0.0], np.geomspace(0.004, 0.4, 60)])
"""Time constants of the filter that are compared."""
_LONGEST_S = 0.05
"""Longest time constant that is reported: high frequencies do not distinguish longer ones."""
_SURE, _MOST = 5.0, 60.0
"""Log-likelihood ratio from which noise counts as smoothed, and its largest value."""
_LEAST = 64
"""Least number of frequencies for an estimate."""

Simulator = Callable[[Sequence[Model], Array, Array], Array]
"""From models (E), commands (T, J) and a first pose to tracks (E, T, 3 + J)."""


@dataclass(frozen=True)
class PoseNoise:
    """Noise of x, y and heading.

    Attributes:
        sd: Standard deviation before the filter, shape (3,).
        lag_s: Time constant of the filter; 0 without a filter.
        colour: Log-likelihood ratio of each of ``LAGS_S`` to white noise; None where poses were
            resampled or lost, which smooths them too.
    """

    sd: Array
    lag_s: float = 0.0
    colour: Array | None = None

    def log_ratio(self, lag_s: float) -> float:
        """Log-likelihood ratio of a filter with this time constant to white noise."""
        return 0.0 if self.colour is None else float(np.interp(lag_s, LAGS_S, self.colour))

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...], period_s: float) -> Array:
        """Random samples of this noise, shape (..., T, 3)."""
        white = rng.standard_normal((*shape, 3)) * self.sd
        weight = _filter_weight(self.lag_s, period_s)
        if weight == 0.0:
            return np.asarray(white)
        state = np.take(white, [0], axis=-2) * weight
        out, _ = lfilter([1 - weight], [1, -weight], white, axis=-2, zi=state)
        return np.asarray(out)


@dataclass(frozen=True)
class Swim:
    """One pool recording on the grid of control periods.

    Attributes:
        name: Name of the recording.
        t: Times in s, shape (T,), every 20 ms.
        command: Set-points in force when each period begins, shape (T, J).
        start: First pose: x, y, heading.
        signals: Surge, sway, yaw rate and the joints' angles, shape (T, 3 + J); NaN where missing.
        noise: Standard deviation of the recording's noise in each signal, shape (3 + J,); 0 where
            it is not known.
        pose: Measured poses, shape (T, 3); None if they are not known.
        repeated: Share of the poses that are identical to those of the sample before.
        pose_noise: Noise of the poses; None where it is not known.
    """

    name: str
    t: Array
    command: Array
    start: Array
    signals: Array
    noise: Array | float = 0.0
    pose: Array | None = None
    repeated: float = 0.0
    pose_noise: PoseNoise | None = None

    @property
    def heading(self) -> Array:
        """Measured heading, shape (T,), smoothed with the same filter as the velocities."""
        if self.pose is None:
            turned = np.cumsum(self.signals[:, 2]) * CONTROL_S
            return np.asarray(self.start[2] + turned - turned[0])
        return np.asarray(savgol_filter(self.pose[:, 2], min(11, self.t.size), 2))


def swim_of(recording: Recording, robot: Robot) -> Swim:
    """A recording, resampled to the control period where its sampling is irregular.

    Raises:
        InputError: If it is no pool recording of this robot, has no poses or no commands.
    """
    validate_recording(recording, robot)
    for joint in robot.joints:
        if joint.name not in recording.joints:
            found, expected = ", ".join(recording.joints), f"the robot's joint {joint.name} too"
            raise InputError(recording.file, "joints", found, expected)
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    for name in names:
        if name not in recording.columns:
            where = recording.path or recording.name
            raise InputError(where, name, "no such column", "poses of the body, in a pool")
    if np.isnan(recording.command).all():
        where = recording.path or recording.name
        raise InputError(where, "header", "no J.command_rad column", "the set-points sent")
    _check_poses(recording, names)
    t = np.arange(recording.t[0], recording.t[-1] + CONTROL_S / 2, CONTROL_S)
    row = np.searchsorted(recording.t, t + 1e-6, side="right") - 1
    order = [recording.joints.index(joint.name) for joint in robot.joints]

    def resampled(column: Array, delay_s: float = 0.0) -> Array:
        finite = np.isfinite(column)
        if finite.sum() < _REST:
            return np.full(t.size, np.nan)
        return np.interp(t, recording.t[finite] + delay_s, column[finite])

    pose = np.stack([recording.columns[name] for name in names], axis=1)
    pose[:, 2] = np.where(np.isfinite(pose[:, 2]), np.unwrap(np.nan_to_num(pose[:, 2])), np.nan)
    grid = np.stack([resampled(column) for column in pose.T], axis=1)
    same = np.all(np.diff(pose[np.isfinite(pose).all(axis=1)], axis=0) == 0, axis=1)
    late_s = context_of(recording)["sample_delay_s"]
    joints = np.stack([resampled(recording.position[:, k], late_s) for k in order], axis=1)
    command = np.nan_to_num(recording.command[row][:, order])
    repeated = float(same.mean()) if same.size else 0.0
    whole = len(recording.t) == t.size and np.allclose(recording.t, t, atol=1e-4)
    whole = whole and bool(np.isfinite(pose).all()) and repeated == 0.0
    noise = _noise_of_poses(grid, whole)
    return Swim(
        name=recording.name,
        t=t - t[0],
        command=command,
        start=grid[:_REST].mean(axis=0),
        signals=np.concatenate([body_velocity(t, grid), joints], axis=1),
        noise=_noise(t, noise, joints),
        pose=grid,
        repeated=repeated,
        pose_noise=noise,
    )


def _check_poses(recording: Recording, names: Sequence[str]) -> None:
    """Check that a swim is long enough, and has enough poses, for velocities."""
    if recording.duration_s < SHORTEST_S:
        found, expected = f"{recording.duration_s:.3g} s", f"a swim of at least {SHORTEST_S:g} s"
        raise InputError(recording.file, "t_s", found, expected)
    for name in names:
        count = int(np.isfinite(recording.columns[name]).sum())
        if count < _REST:
            raise InputError(recording.file, name, f"{count} values", f"at least {_REST}")


def _noise_sd(signals: Array) -> Array:
    """Standard deviation of the noise of smooth signals (T, K), shape (K,).

    From third differences, to which the motion of a robot contributes little: those of white noise
    have 20 times its variance.
    """
    third = np.abs(np.diff(signals, 3, axis=0))
    return np.asarray(np.nan_to_num(np.nanmedian(third, axis=0) / _MEDIAN / np.sqrt(20)))


def _noise_of_poses(grid: Array, whole: bool) -> PoseNoise:
    """Noise of poses (T, 3); its spectrum only where no pose was resampled or lost (``whole``)."""
    noise = pose_noise(grid, CONTROL_S) if whole else None
    if noise is None:
        return PoseNoise(_noise_sd(grid))
    return noise if noise.lag_s > 0 else replace(noise, sd=_noise_sd(grid))


def _noise(t: Array, noise: PoseNoise, joints: Array) -> Array:
    """Noise of surge, sway, yaw rate and joints (T, J).

    That of the velocities is the output of their estimator for random samples of the poses' noise.
    """
    samples = noise.drawn(np.random.default_rng(0), (t.size,), CONTROL_S)
    return np.concatenate([body_velocity(t, samples).std(axis=0), _noise_sd(joints)])


def simulated(swim: Swim, models: Sequence[Model], simulator: Simulator) -> Array:
    """Simulated signals of a swim, with the camera effects of the models, shape (E, T, 3 + J).

    Signals of a robot that was stopped are NaN.
    """
    track = simulator(models, swim.command, swim.start)
    out = np.full((len(models), swim.t.size, track.shape[2]), np.nan)
    swam = np.flatnonzero(np.isfinite(track).all(axis=(1, 2)))
    if swam.size:
        poses = [observed(swim.t, track[e, :, :3], values(models[int(e)])) for e in swam]
        out[swam, :, :3] = body_velocity(swim.t, np.array(poses))
        out[swam, :, 3:] = track[swam, :, 3:]
    return out


def by_twin(robot: Robot, **options: Any) -> Simulator:  # noqa: ANN401 - those of Twin
    """The reduced-order twin as a simulator."""

    def run(models: Sequence[Model], command: Array, start: Array) -> Array:
        twin = Twin(robot, models, n_envs=len(models), **options)
        twin.reset(pose=np.tile(start, (len(models), 1)))
        first = _signals_of(twin)
        return np.concatenate([first[:, None], twin.swim(command[:-1])], axis=1)

    return run


def by_fluid(robot: Robot, **options: Any) -> Simulator:  # noqa: ANN401 - those of Swimmer
    """The lattice-Boltzmann fluid as a simulator."""

    def run(models: Sequence[Model], command: Array, start: Array) -> Array:
        swimmer = Swimmer(robot, models, n_envs=len(models), **options)
        swimmer.reset(pose=np.tile(start, (len(models), 1)))
        track = [_signals_of(swimmer)]
        for sent in tqdm(command[:-1], desc="fluid", unit="step", disable=None, leave=False):
            swimmer.step(sent)
            track.append(_signals_of(swimmer))
        return np.moveaxis(np.array(track), 0, 1)

    return run


def _signals_of(swimmer: Twin | Swimmer) -> Array:
    state = swimmer.state()
    stopped = state.stopped >= 0
    signals = np.concatenate([state.pose, state.measured], axis=1)
    signals[stopped] = np.nan
    return signals


def with_values(model: Model, parameters: Mapping[str, float]) -> Model:
    """The model with parameters by name.

    ``j1.kp_Nm_per_rad`` belongs to a joint, ``twin.along`` to the twin's law,
    ``water.viscosity_m2_s`` to the fluid, anything else to the body's or the camera's effects.
    """
    joints, body = dict(model.joints), dict(model.body)
    law = dict(vars(Coefficients.of(body)))
    effects = values(model)
    for name, value in parameters.items():
        head, _, tail = name.partition(".")
        if head in joints:
            changed: dict[str, Any] = {tail: value}
            joints[head] = replace(joints[head], **changed)
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


def values_of(model: Model, names: Sequence[str]) -> Array:
    """Parameters by name, as ``with_values`` takes them; 0 where the model has no such effect.

    Raises:
        KeyError: If the model has no value of a parameter of the twin or the water.
    """
    effects = values(model)
    out = []
    for name in names:
        head, _, tail = name.partition(".")
        if head in model.joints:
            out.append(float(getattr(model.joints[head], tail)))
        elif head in ("twin", "water"):
            out.append(float(model.body[head][tail]))
        else:
            out.append(effects.get(name, 0.0))
    return np.array(out)


def _filter_weight(lag_s: float, period_s: float) -> float:
    """Weight of the previous output in a first-order filter."""
    return float(np.exp(-period_s / lag_s)) if lag_s > 0 else 0.0


def pose_noise(poses: Array, period_s: float) -> PoseNoise | None:
    """Noise of poses (T, 3) recorded at regular intervals; None where they are too few.

    Third differences remove slow motion, so that it does not leak into high frequencies.
    """
    third = np.diff(poses, 3, axis=0)
    third = third * np.hanning(len(third))[:, None]
    hertz = np.fft.rfftfreq(len(third), period_s)
    high = hertz > ABOVE_HZ
    if high.sum() < _LEAST:
        return None
    angle = 2 * np.pi * period_s * hertz[high]
    power = np.abs(np.fft.rfft(third, axis=0)[high]) ** 2 / np.sum(np.hanning(len(third)) ** 2)
    flat = power / (2 * np.sin(angle / 2))[:, None] ** 6
    # the window correlates neighbouring frequencies: about two thirds are independent
    independent = 2 / 3
    likelihood, sizes = [], []
    for lag in LAGS_S:
        weight = _filter_weight(lag, period_s)
        response = (1 - weight) ** 2 / (1 + weight**2 - 2 * weight * np.cos(angle))
        square = np.mean(flat / response[:, None], axis=0)
        sizes.append(np.sqrt(square))
        log_power = np.log(square) * len(angle) + np.log(response).sum()
        likelihood.append(-independent * float(log_power.sum()))
    log_ratio = np.array(likelihood) - likelihood[0]
    best = int(np.argmax(log_ratio))
    if log_ratio[best] < _SURE:
        best = 0
    while LAGS_S[best] > _LONGEST_S:  # longer time constants differ in the size of the noise only
        best -= 1
    return PoseNoise(sizes[best], float(LAGS_S[best]), np.clip(log_ratio, -_MOST, _MOST))


__all__ = [
    "Coefficients", "PoseNoise", "Simulator", "Swim", "by_fluid", "by_twin", "pose_noise",
    "simulated", "swim_of", "values_of",
]  # fmt: skip
