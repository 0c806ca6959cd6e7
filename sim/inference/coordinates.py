"""Coordinates of the parameters of swims, in which the simulated signals are nearly linear.

Those of a tether are its stiffness and stiffness times anchor, of an appendage its area and area
times place, of a viscoelastic skin a fast and a slow stiffness. A current is added to a simulation
in still water.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sim.inference import signal_error
from sim.inference.swim_parameters import (
    Name,
    Names,
    candidates,
    law_parameters,
    servo_parameters,
)
from sim.inference.swims import SUBSTEPS, Swim, SwimSimulator, seen, with_values
from sim.robot.swimmer import CONTROL_S
from sim.twin.law import Coefficients
from sim2real.arrays import Array, Index, Mask
from sim2real.body import values
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.velocity import turned

LAW = ("across", "along", "added_mass", "thrust", "linear", "slender", "head", "tail", "wake")
"""Coefficients of the twin's law that a diagnosis fits."""
WATER = ("cells", "viscosity", "eddies", "friction", "box")
"""Variants of the fluid's settings (``in_water``)."""
ERROR = "error"
"""Prefix of columns that are shapes of the simulator's error (``signal_error``)."""
WATER_FORCES = ("linear_drag", "form_drag", "surface_friction", "added_mass", "appendage_drag")
"""Effects of drag and added mass. They are not negative: negative friction would drive a robot, and
too much drag of a law is corrected by its own coefficients. Other errors of a law can look like
them."""
QUICK_S, SLOW_S = 0.12, 0.9
"""Relaxation times of the fast and the slow part of a viscoelastic skin."""
LATENCY, SUBSTEP_S = ".latency_s", CONTROL_S / SUBSTEPS
_CURRENT = ("pool_current.u_m_s", "pool_current.v_m_s")
_STIFF, _RELAX = "skin_viscoelasticity.stiffness_Nm_per_rad", "skin_viscoelasticity.relaxation_s"
_PULL = ("tether.stiffness_N_per_m", "tether.x_m", "tether.y_m")
_AREA = ("appendage_drag.area_m2", "appendage_drag.x_m")


class Products(NamedTuple):
    """Limits of the products of an effect's size with its places, which are their coordinates."""

    bound: float
    step: float
    prior_sd: float
    least_size: float


_PLACED = {_PULL: Products(10.0, 0.05, 0.4, 1e-4), _AREA: Products(0.2, 1e-4, 2e-3, 1e-5)}
"""Effects with a place: names of their size and places, and limits of the products."""


@dataclass(frozen=True)
class Column:
    """One coordinate."""

    name: str  # name of its parameter
    effect: Name | None  # the effect it belongs to; None for what every fit varies
    nominal: float  # its value without missing effects
    low: float  # its bounds
    high: float
    step: float  # step of derivatives
    prior_sd: float = np.inf  # standard deviation of the prior of an effect that is present

    @property
    def shown(self) -> bool:
        """Whether it is added to a finished simulation: camera effects and the current."""
        of_camera = self.effect is not None and self.effect[1] == "camera"
        return of_camera or self.name in _CURRENT

    @property
    def kind(self) -> str:
        """Key in ``law_error.json``: the name without joint or material."""
        parts = self.name.split(".")
        if self.effect is None:
            return ".".join((parts[0] if parts[0] in ("twin", "water") else "servo", parts[-1]))
        return f"{parts[0]}.{parts[-1]}"


@dataclass(frozen=True)
class Coordinates:
    """All columns of a robot."""

    model: Model  # the servos, and the law where the model has one
    columns: tuple[Column, ...]  # F of them
    # parameters of the effects that may be missing
    effects: Mapping[Name, Sequence[Parameter]] = field(default_factory=dict)
    # apparent values in reference swims in which nothing is missing, shape (F,): the simulator's
    # error (``learned``), which is added in simulations
    seems: Array | float = 0.0
    place: Mapping[str, int] = field(init=False)  # index of each column by name

    def __post_init__(self) -> None:
        """Index the columns."""
        object.__setattr__(self, "place", {c.name: k for k, c in enumerate(self.columns)})

    @classmethod
    def of(cls, robot: Robot, model: Model) -> Coordinates:
        """The columns of a diagnosis of a robot with these servos."""
        law = law_parameters(Coefficients.of(model.body), LAW)
        columns = _base([*servo_parameters(model, robot, gains=True), *law])
        columns += [
            Column(f"water.{name}", None, 0.0, -4.0, 4.0, 0.5)
            for name in WATER
            if name in model.body.get("water", {})
        ]
        listed = candidates(robot)
        columns += [
            Column(p.name, effect, 0.0, *_limits(effect, free, p))
            for effect, free in listed.items()
            for p in free
        ]
        columns += [
            Column(name, (ERROR, "camera"), 0.0, -1.0, 1.0, 0.01, 0.0)
            for name in signal_error.names(len(robot.joints))
        ]
        return cls(model, tuple(columns), listed)

    @classmethod
    def of_parameters(cls, model: Model, free: Sequence[Parameter]) -> Coordinates:
        """The columns of a calibration, which varies all of them."""
        return cls(model, tuple(_base(free)))

    def of_effect(self, effect: Name) -> list[int]:
        """Columns of an effect."""
        return [self.place[p.name] for p in self.effects[effect]]

    @property
    def base(self) -> list[int]:
        """Columns that every fit varies: servos and law."""
        return [k for k, c in enumerate(self.columns) if c.effect is None]

    def each(self, field: str) -> Array:
        """One field of each column, shape (F,)."""
        return np.array([getattr(c, field) for c in self.columns], dtype=np.float64)

    @property
    def nominal(self) -> Array:
        """Nominal values, shape (F,)."""
        return self.each("nominal")

    def in_fit(self, members: Names) -> Mask:
        """Whether a fit with these effects varies each column, shape (F,)."""
        return np.array([c.effect is None or c.effect in members for c in self.columns])

    def clipped(self, x: Array) -> Array:
        """Points (..., F) within the bounds."""
        return np.clip(x, self.each("low"), self.each("high"))

    def room(self, x: Array) -> Array:
        """Distances from a point (F,) to the lower and upper bounds, shape (2, F)."""
        return np.stack([self.each("low") - x, self.each("high") - x])

    def parameters(self, x: Array) -> dict[str, float]:
        """Parameters by name at a point (F,), without those of effects whose columns are all 0."""
        out = {c.name: float(v) for c, v in zip(self.columns, x, strict=True)}
        if _STIFF in out and _RELAX in self.place and self.effects:
            quick, slow = max(out[_STIFF], 0.0), max(out[_RELAX], 0.0)
            out[_STIFF] = quick + slow
            share = slow / (quick + slow) if quick + slow > 0 else 0.5
            out[_RELAX] = float(np.exp((1 - share) * np.log(QUICK_S) + share * np.log(SLOW_S)))
        for (size, *places), products in _PLACED.items():
            for name in places if size in out and self.effects else ():
                place = out[name] / out[size] if out[size] > products.least_size else 0.0
                out[name] = float(np.clip(place, -10.0, 10.0))
        off = {
            free[0].name.rpartition(".")[0]
            for effect, free in self.effects.items()
            if not any(x[k] for k in self.of_effect(effect))
        }
        return {
            name: v
            for name, v in out.items()
            if name.rpartition(".")[0] not in off and (v or not name.startswith(ERROR))
        }

    def model_at(self, x: Array) -> Model:
        """The model at a point (F,); ``seems`` is stored separately, as ``body.seems``."""
        model = with_values(self.model, self.parameters(x))
        error = np.broadcast_to(self.seems, x.shape)
        seems = {self.columns[k].name: float(error[k]) for k in np.flatnonzero(error)}
        return replace(model, body={**model.body, "seems": seems}) if seems else model

    def steps(self, x: Array) -> Array:
        """Steps of one-sided derivatives about a point (F,), within the bounds."""
        step = self.each("step")
        return np.where(x + step > self.each("high"), -step, step)

    def about(self, x: Array) -> tuple[Array, Index]:
        """Points (F + 1, F) for one-sided derivatives about x, and the base row of each, (F,).

        Row 0 is x, row k + 1 is x with a step in column k; its base is row 0. The place of an
        effect of size 0 has no influence: its base is the row with a step in the size.
        """
        points = np.tile(x, (x.size + 1, 1))
        points[np.arange(1, x.size + 1), np.arange(x.size)] += self.steps(x)
        base = np.zeros(x.size, dtype=np.intp)
        for (name, *places), products in _PLACED.items():
            if name in self.place and x[self.place[name]] < 10 * products.least_size:
                size = self.place[name]
                for k in (self.place[place] for place in places):
                    points[k + 1, size] = points[size + 1, size]
                    base[k] = size + 1
        return points, base


def _base(free: Sequence[Parameter]) -> list[Column]:
    """Columns of what every fit varies; latencies step by a sub-step, where errors have kinks."""
    return [
        Column(
            p.name, None, p.nominal, p.low, p.high,
            max(p.typical / 4, SUBSTEP_S if p.name.endswith(LATENCY) else 0.0), p.prior_sd,
        )
        for p in free
    ]  # fmt: skip


def _limits(
    effect: Name, free: Sequence[Parameter], p: Parameter
) -> tuple[float, float, float, float]:
    """Bounds, step and prior standard deviation of the column of an effect's parameter."""
    if p.name == _RELAX:
        return 0.0, 10.0, free[0].typical / 2, 4 * free[0].typical
    for (_, *places), products in _PLACED.items():
        if p.name in places:
            low = 0.0 if p.low == 0.0 else -products.bound
            return low, products.bound, products.step, products.prior_sd
    low = 0.0 if effect[0] in WATER_FORCES else p.low
    if p.name == _PULL[0]:
        return low, p.high, _PLACED[_PULL].step, _PLACED[_PULL].prior_sd
    return low, p.high, 0.5 * p.typical, p.prior_sd


def signals_at(
    coordinates: Coordinates, swim: Swim, points: Array, simulate: SwimSimulator
) -> Array:
    """Signals of a swim at points (E, F), (E, T, 3 + J); camera and current need no simulation."""
    own = values(coordinates.model)
    shown = [k for k, c in enumerate(coordinates.columns) if c.shown]
    points = points + coordinates.seems
    inner = points.copy()
    inner[:, shown] = 0.0
    unique, inverse = np.unique(inner, axis=0, return_inverse=True)
    still = {name: 0.0 for name in _CURRENT if name in own}
    models = [with_values(coordinates.model, coordinates.parameters(x) | still) for x in unique]
    track = simulate(models, swim)[inverse.reshape(-1)]
    return _signals(track, [own | coordinates.parameters(x) for x in points], swim)


def signals_of(models: Sequence[Model], swim: Swim, simulate: SwimSimulator) -> Array:
    """Signals of a swim by models; current and camera as in ``signals_at``, shape (E, T, 3 + J)."""
    parameters = []
    for model in models:
        effects = values(model)
        seems: Mapping[str, float] = model.body.get("seems", {})
        parameters.append(effects | {name: effects.get(name, 0.0) + v for name, v in seems.items()})
    in_still_water = [
        with_values(
            model,
            {n: 0.0 if n in _CURRENT else v for n, v in by_name.items() if not n.startswith(ERROR)},
        )
        for model, by_name in zip(models, parameters, strict=True)
    ]
    return _signals(simulate(in_still_water, swim), parameters, swim)


def _signals(track: Array, parameters: Sequence[Mapping[str, float]], swim: Swim) -> Array:
    """Signals of tracks (E, T, 3 + J) simulated in still water: with current, camera and error."""
    out = seen(swim.t, track, parameters)
    for e, by_name in enumerate(parameters):
        error_sizes = {n: v for n, v in by_name.items() if n.startswith(ERROR)}
        if error_sizes:
            shapes = signal_error.shapes(out[e])
            out[e] += sum(v * shapes[name] for name, v in error_sizes.items())
    current = [[by_name.get(name, 0.0) for name in _CURRENT] for by_name in parameters]
    out[..., :2] += turned(np.array(current)[:, None], -swim.heading)
    return out
