"""Parameters of swims, and coordinates in which the simulated signals are nearly linear.

Coordinates of a tether are its stiffness and stiffness times anchor, of an appendage its area and
area times place, of a viscoelastic skin a fast and a slow stiffness. A current is added to a
simulation in still water.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim.inference import signal_error
from sim.inference.swims import SUBSTEPS, Swim, SwimSimulator, distinct, seen, with_values
from sim.robot.effects import area_sd
from sim.robot.swimmer import CONTROL_S, least_viscosity
from sim.twin.law import FITTED, Coefficients
from sim2real.arrays import Array, Index, Mask
from sim2real.body import body_effect, listed, values
from sim2real.effects import BODY, CAMERA, named
from sim2real.effects.body_effect import BodyEffect, CameraEffect
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.velocity import turned

Name = tuple[str, str]
"""An effect of body or camera, and the material that it belongs to, or ``body`` or ``camera``."""
Names = frozenset[Name]
LAW = ("across", "along", "added_mass", "thrust", "linear", "slender", "head", "tail", "wake")
"""Coefficients of the twin's law that a diagnosis fits."""
WATER = ("cells", "viscosity", "eddies", "friction", "box")
"""Variants of the fluid's settings (``in_water``)."""
ERROR = "error"
"""Prefix of columns that are shapes of the simulator's error (``signal_error``)."""
WATER_FORCES = ("linear_drag", "form_drag", "surface_friction", "added_mass", "appendage_drag")
"""Effects of drag and added mass, which errors of a law can look like. They are not negative: the
law's own coefficients correct too much drag."""
QUICK_S, SLOW_S = 0.12, 0.9
"""Relaxation times of the fast and the slow part of a viscoelastic skin."""
LATENCY, SUBSTEP_S = ".latency_s", CONTROL_S / SUBSTEPS
_CURRENT = ("pool_current.u_m_s", "pool_current.v_m_s")
_STIFF, _RELAX = "skin_viscoelasticity.stiffness_Nm_per_rad", "skin_viscoelasticity.relaxation_s"
_PLACES = {
    "tether.x_m": ("tether.stiffness_N_per_m", 1e-4),
    "tether.y_m": ("tether.stiffness_N_per_m", 1e-4),
    "appendage_drag.x_m": ("appendage_drag.area_m2", 1e-5),
}
"""Places whose coordinates are size times place: the size, and the least with an influence."""
_LIMITS = {
    "tether.stiffness_N_per_m": (0.0, 10.0, 0.05, 0.4),
    "tether.x_m": (-10.0, 10.0, 0.05, 0.4),
    "tether.y_m": (-10.0, 10.0, 0.05, 0.4),
    "appendage_drag.x_m": (0.0, 0.2, 1e-4, 2e-3),
    _RELAX: (0.0, 10.0, 0.15, 1.2),
}
"""Bounds, step and prior standard deviation of coordinates, where not those of the parameter."""
SERVO = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
SERVOS = "servos"
"""Component of effects that all servos share, each of a size of its own in every joint."""
SERVO_EFFECTS = ("coulomb_friction",)
"""Effects of the servos' catalogue that the joints' angles of a swim show."""
AREAS = "appendage_area"
"""Error of what the robot file states, which a calibration fits: no physics that it leaves out."""
_CALIBRATED = ("across", "along", "added_mass", "linear", "thrust", "wake", "wake_s")
"""Coefficients of the law that a calibration fits: a few swims do not distinguish the others from
these, and they could conceal a missing effect."""
_USUAL = {"across": 1.0, "along": 0.2, "added_mass": 0.2, "linear": 0.2}
"""Least usual values of coefficients, for those whose fitted values are smaller."""
_LAW_SD = {"thrust": 0.5, "wake": 0.3, "wake_s": FITTED.wake_s}
_HIGHEST = {"thrust": 2.0, "wake": 0.95, "wake_s": 10.0}
"""Prior standard deviations and upper bounds that are not multiples of the usual value."""


def law_parameters(law: Coefficients, names: Sequence[str]) -> list[Parameter]:
    """Coefficients of the twin's law, about those of ``law``."""
    out = []
    for name in names:
        value = float(getattr(law, name))
        size = max(abs(value), 0.1)
        usual = max(size, _USUAL.get(name, 0.0))
        high, sd = _HIGHEST.get(name, 20 * usual), _LAW_SD.get(name, 2 * usual)
        low = 0.05 if name == "wake_s" else 0.0
        out.append(Parameter(f"twin.{name}", low, high, 0.4 * size, value, sd))
    return out


def servo_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Latencies of all joints, which a radio link changes, and their gains if asked."""
    out = []
    for joint in robot.joints:
        servo = model.joints[joint.name]
        for name in SERVO if gains else SERVO[2:]:
            value = float(getattr(servo, name))
            size = max(abs(value), 1e-3)
            sd = (0.5 if name == "latency_s" else 0.1) * size
            bounds = (0.1 * size, 5 * size)
            out.append(Parameter(f"{joint.name}.{name}", *bounds, 0.2 * size, value, sd))
    return out


def twin_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Parameter]:
    """Parameters of a calibration in the twin: its law, the appendages' areas, the servos."""
    servos = servo_parameters(model, robot, gains=gains)
    law = Coefficients.of(model.body) if "twin_links" in model.body else FITTED
    return [*law_parameters(law, _CALIBRATED), *appendage_parameters(robot), *servos]


def appendage_parameters(robot: Robot) -> list[Parameter]:
    """The error of the drag areas of the appendages in the robot file; none without appendages."""
    if not robot.appendages:
        return []
    (ratio,) = effect_parameters(AREAS)
    return [replace(ratio, prior_sd=max(area_sd(robot), ratio.typical / 10))]


def effect_parameters(effect: str, material: str | None = None) -> list[Parameter]:
    """Parameters of a body or camera effect."""
    described = body_effect(effect)
    prefix = f"{effect}.{material}" if described.by_material else effect
    out = []
    for k, p in enumerate(described.parameters):
        start = max(0.0 if k == 0 or p.low < 0 else p.typical, p.low)
        name, sd = f"{prefix}.{p.name}", 4 * p.typical
        out.append(Parameter(name, p.low, p.high, p.typical, start, sd, unit=p.unit))
    return out


def water_parameters(robot: Robot, cell_m: float) -> list[Parameter]:
    """Drag, friction and added mass of the body, and the viscosity for cells of a size."""
    out = effect_parameters("form_drag") + effect_parameters("linear_drag")
    for material in _materials(robot):
        out += effect_parameters("surface_friction", material)
    out += appendage_parameters(robot) + effect_parameters("added_mass")
    least = least_viscosity(cell_m)
    bounds = (least, 20 * least)
    viscosity = ("water.viscosity_m2_s", *bounds, 0.4 * least, 1.2 * least, 0.6 * least)
    return [*out, Parameter(*viscosity)]


def candidates(robot: Robot) -> dict[Name, list[Parameter]]:
    """Effects of servos, body and camera that this robot may have."""
    out = {
        (effect, SERVOS): [
            replace(p, name=f"{joint.name}.{effect}.{p.name}", prior_sd=4 * p.typical)
            for joint in robot.joints
            for p in named(effect).parameters
        ]
        for effect in SERVO_EFFECTS
    }
    effects: tuple[BodyEffect | CameraEffect, ...] = (*BODY, *CAMERA)
    for effect in (effect for effect in effects if effect.name != AREAS):
        component = "camera" if isinstance(effect, CameraEffect) else "body"
        for material in _materials(robot) if effect.by_material else [None]:
            out[effect.name, material or component] = effect_parameters(effect.name, material)
    area, place = out["appendage_drag", "body"]
    # twice the largest cross-section: no file leaves out more drag area
    largest = max(2 * np.pi / 4 * link.width_m * link.height_m for link in robot.links)
    out["appendage_drag", "body"] = [replace(area, high=largest), place]
    return out


def _materials(robot: Robot) -> list[str]:
    """Materials of a robot's links, in order."""
    return sorted({link.material or "" for link in robot.links})


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
    def kind(self) -> str:
        """Key in ``law_error.json``: the name without joint or material."""
        head, *_, tail = self.name.split(".")
        if self.effect is not None and self.effect[1] == SERVOS:
            head = self.effect[0]
        own = self.effect is not None or head in ("twin", "water")
        return f"{head if own else 'servo'}.{tail}"


@dataclass(frozen=True)
class Coordinates:
    """All columns of a robot."""

    model: Model  # the servos, and the law where the model has one
    columns: tuple[Column, ...]  # F of them
    # apparent values in reference swims in which nothing is missing, shape (F,): the simulator's
    # error (``learned``), which is added in simulations
    seems: Array | float = 0.0
    place: Mapping[str, int] = field(init=False)  # index of each column by name
    effects: Mapping[Name, list[int]] = field(init=False)  # columns of each that may be missing

    def __post_init__(self) -> None:
        """Index the columns."""
        effects: dict[Name, list[int]] = {}
        for k, c in enumerate(self.columns):
            if c.effect is not None and c.effect[0] != ERROR:
                effects.setdefault(c.effect, []).append(k)
        object.__setattr__(self, "place", {c.name: k for k, c in enumerate(self.columns)})
        object.__setattr__(self, "effects", effects)

    @classmethod
    def of(cls, robot: Robot, model: Model, free: Sequence[Parameter] = ()) -> Coordinates:
        """The columns of a diagnosis of a robot with these servos.

        The parameters that a calibration has ``free`` come first; effects of its model are known.
        """
        law = law_parameters(Coefficients.of(model.body), LAW)
        usual = [*servo_parameters(model, robot, gains=True), *law]
        given = {p.name for p in free}
        columns = varied([*free, *(p for p in usual if p.name not in given)])
        waters = model.body.get("water", {})
        columns += [Column(f"water.{n}", None, 0.0, -4.0, 4.0, 0.5) for n in WATER if n in waters]
        known = values(model).keys() if free else set()
        for effect, some in candidates(robot).items():
            for p in some if not known & {p.name for p in some} else ():
                low = 0.0 if effect[0] in WATER_FORCES else p.low
                own = low, p.high, 0.5 * p.typical, p.prior_sd
                columns.append(Column(p.name, effect, 0.0, *_LIMITS.get(p.name, own)))
        columns += [
            Column(name, (ERROR, "camera"), 0.0, -1.0, 1.0, 0.01, 0.0)
            for name in signal_error.kinds_of(len(robot.joints))
        ]
        return cls(model, tuple(columns))

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

    def parameters(self, x: Array) -> dict[str, float]:
        """Parameters by name at a point (F,), without those of effects whose columns are all 0."""
        out = {c.name: float(v) for c, v in zip(self.columns, x, strict=True)}
        absent = [k for own in self.effects.values() if not x[own].any() for k in own]
        if _STIFF in out and self.effects:
            quick, slow = max(out[_STIFF], 0.0), max(out[_RELAX], 0.0)
            out[_STIFF] = quick + slow
            share = slow / (quick + slow) if quick + slow > 0 else 0.5
            out[_RELAX] = float(QUICK_S ** (1 - share) * SLOW_S**share)
        for name, (of, least) in _PLACES.items():
            if name in out and self.effects:
                place = out[name] / out[of] if out[of] > least else 0.0
                out[name] = float(np.clip(place, -10.0, 10.0))
        for k in absent:
            del out[self.columns[k].name]
        return out

    def model_at(self, x: Array) -> Model:
        """The model at a point (F,); the simulator's error is stored apart, as ``body.seems``.

        Sizes of a servo's effects that reference swims have too are in the model.
        """
        parameters, seems = self.parameters(x), np.broadcast_to(self.seems, x.shape)
        for k in (k for effect, own in self.effects.items() if effect[1] == SERVOS for k in own):
            size = parameters.pop(self.columns[k].name, 0.0) + float(seems[k])
            parameters |= {self.columns[k].name: size} if size > 0 else {}
        names = [name for name in parameters if name.startswith(ERROR)]
        error = {name: parameters.pop(name) + float(seems[self.place[name]]) for name in names}
        model = with_values(self.model, parameters)
        body = {name: part for name, part in model.body.items() if name != "seems"}
        stated = {name: v for name, v in error.items() if v}
        return replace(model, body=body | ({"seems": stated} if stated else {}))

    def steps(self, x: Array) -> Array:
        """Steps of one-sided derivatives about a point (F,), within the bounds."""
        step = self.each("step")
        return np.where(x + step > self.each("high"), -step, step)

    def about(self, x: Array) -> tuple[Array, Index]:
        """Points (F + 1, F) for one-sided derivatives about x, and the base row of each, (F,).

        Row 0 is x, row k + 1 is x with a step in column k. The place of an effect of size 0 has no
        influence: its base is the row with a step in the size.
        """
        points = np.tile(x, (x.size + 1, 1))
        points[np.arange(1, x.size + 1), np.arange(x.size)] += self.steps(x)
        base = np.zeros(x.size, dtype=np.intp)
        for name, (of, least) in _PLACES.items():
            if name in self.place and x[self.place[of]] < 10 * least:
                k, size = self.place[name], self.place[of]
                points[k + 1, size] = points[size + 1, size]
                base[k] = size + 1
        return points, base


def varied(free: Sequence[Parameter]) -> list[Column]:
    """Columns of what every fit varies; latencies step by a sub-step, where errors have kinks."""
    return [
        Column(
            p.name, None, p.nominal, p.low, p.high,
            max(p.typical / 4, SUBSTEP_S if p.name.endswith(LATENCY) else 0.0), p.prior_sd,
        )
        for p in free
    ]  # fmt: skip


def is_shown(name: str) -> bool:
    """Whether a parameter is added to a finished simulation: camera effects and the current."""
    return name in _CURRENT or name.partition(".")[0] in {effect.name for effect in CAMERA}


def signals_at(
    coordinates: Coordinates, swim: Swim, points: Array, simulate: SwimSimulator
) -> Array:
    """Signals of a swim at points (E, F), shape (E, T, 3 + J)."""
    return signals_of([coordinates.model_at(x) for x in points], swim, simulate)


def signals_of(models: Sequence[Model], swim: Swim, simulate: SwimSimulator) -> Array:
    """Signals of a swim by models, shape (E, T, 3 + J).

    They are simulated in still water; current, camera and the simulator's error are added.
    """
    effects = [values(model) for model in models]
    bare = []
    for model, known in zip(models, effects, strict=True):
        inner = listed({name: v for name, v in known.items() if not is_shown(name)})
        bare.append(replace(model, body={**model.body, "effects": inner, "seems": {}}))
    unique, inverse = distinct(bare)
    out = seen(swim.t, simulate(unique, swim)[inverse], effects)
    for signals, model in zip(out, models, strict=True):
        if sizes := model.body.get("seems"):
            shapes = signal_error.shapes(signals)
            signals += sum(sizes.get(name, 0.0) * shape for name, shape in shapes.items())
    current = [[known.get(name, 0.0) for name in _CURRENT] for known in effects]
    out[..., :2] += turned(np.array(current)[:, None], -swim.heading)
    return out
