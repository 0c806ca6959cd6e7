"""The coefficients of the twin's law, fitted to swims of a robot in the fluid by least squares."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.law import FITTED, Coefficients, links_of
from sim.twin.twin import Twin
from sim2real.arrays import Array, Index
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.robot import Robot
from sim2real.velocity import body_velocity

WAVES: dict[str, tuple[float, ...]] = {
    "wave 1 Hz": (1.0, 1.0),
    "wave 1.5 Hz": (1.5, 0.8),
    "wave 0.75 Hz": (0.75, 1.2),
    "weak wave": (1.0, 0.6),
    "left turn": (1.2, 0.7, 0.3),
    "square 0.5 Hz": (0.5, 0.52),
    "long wave": (1.2, 0.9, 0.0, 0.5),
    "right turn": (1.5, 0.8, -0.4),
    "wave 1.75 Hz": (1.75, 0.7),
    "wave 2.25 Hz": (2.25, 0.5),
    "slow wave": (0.5, 1.3),
    "strong wave": (1.0, 1.25),
    "short wave": (1.2, 0.9, 0.0, 1.4),
    "sine 0.8 Hz, all joints": (0.8, 0.4),
    "sine 1.3 Hz, all joints": (1.3, 0.45),
    "tight left turn": (1.0, 0.8, 0.4),
    "slight right turn": (1.3, 0.9, -0.15),
    "wave that rests": (1.2, 0.9),
    "sine 1 Hz, all joints": (1.0, 0.52),
    "wave 1.25 Hz": (1.25, 0.9),
    "gentle turn": (1.0, 1.0, 0.2),
    "wave 2 Hz": (2.0, 0.6),
    "longer wave 0.9 Hz": (0.9, 1.1, 0.0, 0.75),
    "right turn 1.1 Hz": (1.1, 0.9, -0.25),
}
"""Frequency in Hz of each swim and its amplitude, relative or in rad (square and sine), of waves
also the bend in rad and the lag of the joints relative to 1.2 rad from each to the next."""
HELD_OUT = tuple(WAVES)[18:]
"""Swims that the fit does not see: other waves, turns and sines than those before them."""
NAMES = tuple(field.name for field in fields(Coefficients))
_BOUNDS = {
    "slender": (0.2, 20.0),
    "head": (0.05, 2.0),
    "wake": (1e-3, 0.95),
    "wake_s": (0.1, 10.0),
    "tail": (0.2, 5.0),
    "lag": (0.02, 10.0),
}
STARTS = (
    FITTED,
    Coefficients(4.0, 1.0, 1.0, 0.3, 1.0, 2.0, 0.5, 0.3, 0.5, 1.0, 1.0, 0.5),
    Coefficients(2.0, 0.3, 0.8, 0.8, 0.3, 2.0, 0.8, 0.1, 0.2, 2.0, 1.0, 0.2),
)


def set_points(robot: Robot, names: Sequence[str], seconds: float) -> Array:
    """Set-points in rad of the swims that are named, shape (swims, T, J), within the limits."""
    t, J = CONTROL_S * np.arange(round(seconds / CONTROL_S))[:, None], len(robot.joints)
    most = np.min([np.abs(joint.limits_rad).min() for joint in robot.joints])
    most = min(0.78, 0.975 * float(most))  # of joints that bend less all angles are smaller
    size, out = np.linspace(0.6, 0.3, J)[::-1], []
    for name in names:
        hertz, scale, bend, lag = WAVES[name] + (0.0, 1.0)[len(WAVES[name]) - 2 :]
        if name.startswith(("sine", "square")):
            sine = np.sin(2 * np.pi * hertz * t)
            angle = scale * (np.sign(sine) if name.startswith("square") else sine) * np.ones(J)
        else:
            beat = np.sin(2 * np.pi * hertz * t - 1.2 * lag * np.arange(J))
            angle = np.minimum(1.0, t) * (scale * size * beat + bend)
        if name.endswith("rests"):
            angle = angle * (1 - np.clip((t - 4.0) / 0.5, 0, 1) * np.clip((7.0 - t) / 0.5, 0, 1))
        out.append(np.clip(angle * most / 0.78, -most, most))
    return np.array(out)


@dataclass(frozen=True)
class Swims:
    """Swims of E signals in the fluid, and of the same in the twin."""

    robot: Robot  # without appendages: fluid and twin take their forces from the same figures
    model: Model  # its servos, without effects of the body
    names: tuple[str, ...]  # names of the signals, of ``WAVES``
    track: Array  # poses and angles in the fluid at the end of each period, shape (E, T, 3 + J)

    @property
    def truth(self) -> Array:
        """What the fluid shows, shape (E, T, 3 + J)."""
        return shown(self.track)

    @property
    def rms(self) -> Array:
        """Its root mean square, shape (E, 3 + J)."""
        return np.asarray(np.sqrt(np.mean(self.truth**2, axis=1)))

    def by_twin(self, laws: Sequence[Coefficients], which: Index) -> Array:
        """What the twin shows under each law, shape (laws, which, T, 3 + J)."""
        body = self.model.body
        models = [replace(self.model, body={**body, "twin": vars(law)}) for law in laws]
        each = [model for model in models for _ in which]
        sent = set_points(self.robot, self.names, self.track.shape[1] * CONTROL_S)
        track = Twin(self.robot, each, n_envs=len(each)).swim(sent, np.tile(which, len(laws)))
        return shown(track).reshape(len(laws), which.size, *self.track.shape[1:])

    def errors(self, law: Coefficients) -> Array:
        """Root mean square errors relative to the swims' own root mean square, (E, 3 + J)."""
        off = self.by_twin([law], np.arange(len(self.names)))[0] - self.truth
        return np.asarray(np.sqrt(np.mean(off**2, axis=1)) / self.rms)

    def fitted(self, seen: Index, start: Coefficients) -> OptimizeResult:
        """Least squares on the swims ``seen`` from one start, in the coefficients' logarithms."""
        truth, rms = self.truth[seen], self.rms[seen][:, None]

        def errors(rows: Array) -> Array:
            swum = self.by_twin([law_of(row) for row in rows], seen)
            return np.nan_to_num((swum - truth) / rms, nan=1e3).reshape(len(rows), -1)

        def slope(x: Array) -> Array:
            step = 0.02 * np.eye(x.size)
            swum = errors(np.concatenate([x + step, x - step])).reshape(2, x.size, -1)
            return np.asarray(((swum[0] - swum[1]) / 0.04).T)

        low, high = np.log([_BOUNDS.get(name, (1e-3, 100.0)) for name in NAMES]).T
        x0 = np.clip(np.log([max(getattr(start, name), 1e-9) for name in NAMES]), low, high)

        def residual(x: Array) -> Array:
            return np.asarray(errors(x[None])[0])

        return least_squares(residual, x0, slope, bounds=(low, high), max_nfev=40, ftol=1e-5)


def shown(track: Array) -> Array:
    """Surge, sway, yaw rate and joints' angles of each swim (E, T, 3 + J), in the same shape."""
    t = CONTROL_S * np.arange(1, track.shape[1] + 1)
    return np.concatenate([body_velocity(t, track[:, :, :3]), track[:, :, 3:]], axis=-1)


def hull_alone(robot: Robot) -> Robot:
    """The robot without appendages."""
    return replace(robot, links=tuple(replace(link, appendages=()) for link in robot.links))


def law_of(x: Array) -> Coefficients:
    """Coefficients of their logarithms."""
    return Coefficients(*np.exp(x).tolist())


def swum(
    robot: Robot, model: Model, seconds: float, progress: Progress, *, cell_m: float, device: str
) -> Swims:
    """Swim all signals in the fluid, with the hull and the servos alone.

    Raises:
        InputError: If the fluid stops the robot.
    """
    body = {k: model.body[k] for k in ("normalised_density",) if k in model.body}
    bare, names = replace(model, body=body), tuple(WAVES)
    sent, track = set_points(robot, names, seconds), []
    swimmer = Swimmer(
        hull_alone(robot), bare, n_envs=len(sent), cell_m=cell_m, device=device, threads=2
    )
    for k in range(sent.shape[1]):
        swimmer.step(sent[:, k])
        track.append(swimmer.track())
        progress((k + 1) / sent.shape[1])
    tracks = np.moveaxis(np.array(track), 0, 1)
    for name, one in zip(names, tracks, strict=True):
        if not np.isfinite(one).all():
            raise InputError("fit-twin", name, "a robot that the fluid stops", "finer cells")
    return Swims(hull_alone(robot), bare, names, tracks)


def fit_twin(model: Model, swims: Swims, progress: Progress) -> Model:
    """The model with the law of the best fit from ``STARTS``; ``fit`` has the relative errors.

    The errors of surge, sway and yaw rate are root mean squares over the swims, ``train`` and
    ``heldout``, and ``fish`` over those held out by the law of the shipped fish.
    """
    held, found = np.array([name in HELD_OUT for name in swims.names]), []
    for k, start in enumerate(STARTS):
        found.append(swims.fitted(np.flatnonzero(~held), start))
        progress((k + 1) / len(STARTS))
    law = law_of(min(found, key=lambda one: one.cost).x)
    fish, own = (np.square(swims.errors(one)) for one in (FITTED, law))
    parts = {"train": own[~held], "heldout": own[held], "fish": fish[held]}
    errors = {name: np.sqrt(part.mean(axis=0)) for name, part in parts.items()}
    fit = {
        f"twin.{name}": {part: float(x[k]) for part, x in errors.items()}
        for k, name in enumerate(("surge", "sway", "yaw_rate"))
    }
    body = {**model.body, "twin": vars(law), "twin_links": links_of(swims.robot)}
    for stale in ("posterior", "interval"):  # of another law
        body.pop(stale, None)
    return replace(model, body=body, fit={**model.fit, **fit})
