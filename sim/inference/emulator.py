"""An emulator: a linear model of a simulator near a model, from one batch of rollouts.

The wake of the fluid is turbulent, so that differences of two rollouts would be noise: all
parameters are varied at once (a Sobol sequence: Santner, Williams, Notz, The Design and Analysis of
Computer Experiments, Springer 2003), and the displacements in every control period are regressed on
all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from sim.inference.swims import Simulator, Swim, SwimSimulator, path_of, steps_of, with_values
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter, column
from sim2real.model import Model

REACH = 0.75
"""Half-width of a batch about its centre, in the parameters' typical sizes."""
_VISCOSITY = "water.viscosity_m2_s"
"""Parameter in whose logarithm a rollout is nearly linear."""


def emulator(
    simulator: Simulator,
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    *,
    count: int,
    seed: int = 0,
    ridge: float = 1.0,
) -> SwimSimulator:
    """A simulator of these swims near a model; parameters that are not varied have no influence.

    Those that are ``free`` are varied in ``count`` rollouts of each swim, of which the first is of
    the model itself. ``ridge`` is the penalty of the slopes, against a weight of one per rollout.
    """
    if count < len(free) + 2:
        expected = f"at least {len(free) + 2}, for {len(free)} parameters"
        raise InputError("emulator", "rollouts", str(count), expected)
    names = [p.name for p in free]
    centre, reach = _values_of(model, names), REACH * column(free, "typical")
    low = np.maximum(centre - reach, column(free, "low"))
    high = np.minimum(low + 2 * reach, column(free, "high"))
    shares = qmc.Sobol(len(free), rng=seed).random_base2((count - 1).bit_length())
    drawn = np.concatenate([centre[None], low + (high - low) * shares[: count - 1]])
    models = [with_values(model, dict(zip(names, row, strict=True))) for row in drawn]
    by_log = [k for k, name in enumerate(names) if name == _VISCOSITY]

    def linear(rows: Array) -> Array:
        rows = rows.copy()
        rows[:, by_log] = np.log(rows[:, by_log])
        return rows

    mean, size = linear(drawn).mean(axis=0), np.maximum(linear(drawn).std(axis=0), 1e-12)

    def terms(rows: Array) -> Array:
        return np.concatenate([np.ones((len(rows), 1)), (linear(rows) - mean) / size], axis=1)

    penalty = ridge * np.diag([0.0, *np.ones(len(free))])
    regressed = {}
    for swim in swims:
        track = simulator(models, swim.command, swim.start)
        finite = np.asarray(np.isfinite(track).all(axis=(1, 2)))
        if finite.mean() < 0.5:
            found = f"{np.sum(~finite)} of {finite.size} rollouts stopped"
            raise InputError(swim.name, "simulator", found, "most of them whole")
        steps, x = steps_of(track[finite]), terms(drawn[finite])
        flat = np.linalg.solve(x.T @ x + penalty, x.T @ steps.reshape(len(steps), -1))
        regressed[swim] = flat.reshape(-1, *steps.shape[1:]), track[finite][0, 0, 3:]

    def simulate(models: Sequence[Model], swim: Swim) -> Array:
        weights, angles = regressed[swim]
        rows = np.array([_values_of(model, names) for model in models])
        return path_of(np.tensordot(terms(rows), weights, axes=1), swim.start, angles)

    return simulate


def _values_of(model: Model, names: Sequence[str]) -> Array:
    """Parameters by name, as ``with_values`` takes them; 0 where the model has no such effect."""
    known = values(model)
    parts = {name: vars(joint) for name, joint in model.joints.items()}
    parts |= {name: model.body.get(name, {}) for name in ("twin", "water")}
    for head, part in parts.items():
        known |= {f"{head}.{tail}": value for tail, value in part.items()}
    return np.array([float(known.get(name, 0.0)) for name in names])
