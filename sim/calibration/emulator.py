"""An emulator: a linear model of a simulator near a model, from one batch of rollouts.

The fluid takes a second of a GPU for half a minute of swimming, and its wake is turbulent: two
rollouts of nearly the same robot differ by as much as a small change of a parameter causes, so that
finite differences of two rollouts would be noise. So a batch is simulated with all parameters
varied at once (a Sobol sequence, as in the design of computer experiments: Santner, Williams, Notz,
Springer 2003), and every sample is regressed on all of them: each slope uses the whole batch, which
averages the turbulence. The regressed quantities are the displacements of the head forward, to the
left and in heading in each control period, and the joints' angles; the path is their integral.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from sim.inference.swims import Simulator, Swim, values_of, with_values
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter
from sim2real.model import Model

ROLLOUTS = 48
"""Rollouts of a batch: 42 s on an H200 in cells of 1 cm."""
REACH = 0.75
"""Half-width of a batch about its centre, in the parameters' typical sizes."""
_RIDGE = 1.0
"""Ridge penalty of the slopes, against a weight of one per rollout."""


@dataclass(frozen=True)
class Batch:
    """Rollouts of one swim.

    Attributes:
        swim: The swim whose commands were simulated.
        names: Parameters that were varied.
        values: Their values, shape (E, F); the first row is the centre.
        track: Poses and measured joint angles, shape (E, T, 3 + J).
    """

    swim: Swim
    names: tuple[str, ...]
    values: Array
    track: Array


def rollouts(
    simulator: Simulator,
    swim: Swim,
    model: Model,
    free: Sequence[Parameter],
    *,
    count: int = ROLLOUTS,
    seed: int = 0,
) -> Batch:
    """Simulate a batch about a model; the first rollout is of the model itself.

    Raises:
        InputError: If there are too few rollouts to regress on all parameters.
    """
    if count < len(free) + 2:
        expected = f"at least {len(free) + 2}, for {len(free)} parameters"
        raise InputError("emulator", "rollouts", str(count), expected)
    names = tuple(p.name for p in free)
    centre = values_of(model, names)
    reach = REACH * np.array([p.typical for p in free])
    low = np.maximum(centre - reach, [p.low for p in free])
    high = np.minimum(low + 2 * reach, [p.high for p in free])
    shares = qmc.Sobol(len(free), rng=seed).random_base2((count - 1).bit_length())
    values = np.concatenate([centre[None], low + (high - low) * shares[: count - 1]])
    models = [with_values(model, dict(zip(names, row, strict=True))) for row in values]
    return Batch(swim, names, values, simulator(models, swim.command, swim.start))


class Emulator:
    """A ``Simulator`` of the swims of its batches, near the models of these batches.

    Parameters that no batch varied have no influence.
    """

    def __init__(self, batches: Sequence[Batch]) -> None:
        """Regress every sample of each swim on the parameters.

        Args:
            batches: One for each swim. Rollouts that were stopped are excluded.

        Raises:
            InputError: If most of a batch was stopped.
        """
        self._regressions: dict[bytes, dict[bytes, _Regression]] = {}
        for batch in batches:
            same_commands = self._regressions.setdefault(batch.swim.command.tobytes(), {})
            same_commands[batch.swim.start.tobytes()] = _Regression(batch)

    def __call__(self, models: Sequence[Model], command: Array, start: Array) -> Array:
        """Tracks of models, shape (E, T, 3 + J); ``Simulator``.

        Swims with the same commands are distinguished by their first pose; a single one is used for
        every first pose.

        Raises:
            KeyError: If no batch has these commands, or several have, none with this first pose.
        """
        same_commands = self._regressions[command.tobytes()]
        single = next(iter(same_commands.values())) if len(same_commands) == 1 else None
        regression = same_commands.get(start.tobytes(), single)
        if regression is None:
            raise KeyError(f"{len(same_commands)} swims with these commands, none from {start}")
        return regression.track(models, start)


class _Regression:
    def __init__(self, batch: Batch) -> None:
        finite = np.asarray(np.isfinite(batch.track).all(axis=(1, 2)))
        if finite.mean() < 0.5:
            found = f"{np.sum(~finite)} of {finite.size} rollouts stopped"
            raise InputError(batch.swim.name, "simulator", found, "most of them whole")
        steps = steps_of(batch.track[finite])
        places = [
            coordinates_of(dict(zip(batch.names, row, strict=True))) for row in batch.values[finite]
        ]
        self.names = batch.names
        x = np.array([list(place.values()) for place in places])
        self._centre, self._size = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-12)
        terms = self._terms(x)
        ridge = np.full(terms.shape[1], _RIDGE)
        ridge[0] = 0.0
        normal = terms.T @ terms + np.diag(ridge)
        flat = steps.reshape(len(steps), -1)
        self._weights = np.linalg.solve(normal, terms.T @ flat)
        self._shape = steps.shape[1:]
        self._joint = batch.track[finite][0, 0, 3:]

    def _terms(self, x: Array) -> Array:
        z = (x - self._centre) / self._size
        return np.concatenate([np.ones((len(z), 1)), z], axis=1)

    def track(self, models: Sequence[Model], start: Array) -> Array:
        rows = [values_of(model, self.names) for model in models]
        places = [coordinates_of(dict(zip(self.names, row, strict=True))) for row in rows]
        x = np.array([list(place.values()) for place in places])
        steps = (self._terms(x) @ self._weights).reshape(len(models), *self._shape)
        return path_of(steps, start, self._joint)


def coordinates_of(values: Mapping[str, float]) -> dict[str, float]:
    """Coordinates in which a rollout is nearly linear: the logarithm of the viscosity."""
    out = dict(values)
    if "water.viscosity_m2_s" in out:
        out["water.viscosity_m2_s"] = float(np.log(out["water.viscosity_m2_s"]))
    return out


def steps_of(track: Array) -> Array:
    """Displacements forward, to the left, of the heading, and joint angles: (E, T - 1, 3 + J)."""
    change = np.diff(track[..., :3], axis=1)
    heading = track[:, :-1, 2]
    c, s = np.cos(heading), np.sin(heading)
    forward, aside = (
        c * change[..., 0] + s * change[..., 1],
        c * change[..., 1] - s * change[..., 0],
    )
    return np.concatenate(
        [np.stack([forward, aside, change[..., 2]], axis=2), track[:, 1:, 3:]], axis=2
    )


def path_of(steps: Array, start: Array, joint: Array) -> Array:
    """The path from a first pose, the inverse of ``steps_of``."""
    zero = np.zeros((len(steps), 1))
    heading = start[2] + np.concatenate([zero, np.cumsum(steps[..., 2], axis=1)], axis=1)
    c, s = np.cos(heading[:, :-1]), np.sin(heading[:, :-1])
    x = np.cumsum(c * steps[..., 0] - s * steps[..., 1], axis=1)
    y = np.cumsum(s * steps[..., 0] + c * steps[..., 1], axis=1)
    x, y = (a + np.concatenate([zero, b], axis=1) for a, b in zip(start[:2], (x, y), strict=True))
    first = np.broadcast_to(joint, (len(steps), joint.shape[-1]))[:, None]
    angles = np.concatenate([first, steps[..., 3:]], axis=1)
    return np.concatenate([np.stack([x, y, heading], axis=2), angles], axis=2)
