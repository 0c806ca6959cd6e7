"""The fitted model of a robot, and its file ``MODEL.json``."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import nan
from typing import Any, Literal, get_args

from pandas import DataFrame

from sim2real.arm.description import Arm, arm_content, arm_from
from sim2real.clock import SHORTEST_PERIOD_S
from sim2real.display import Drawing, NotebookDisplay, from_report
from sim2real.inference.normal import LEVEL
from sim2real.output import write_json
from sim2real.recording import Load, read_load
from sim2real.structured import Fields, finite_number, read_json

SCHEMA = "sim2real.model/1"
_ROTOR_IN_LOAD = "rotor_in_load"
"""False in files. In earlier ones, which lack it, the load includes the rotor of a gear train."""
_ROTOR, _LEFT_OUT = "rotor_inertia_kgm2", "unmodelled_inertia"
_GAINS = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")

Law = Literal["pd", "motor", "current_limited"]
LAWS: tuple[Law, ...] = get_args(Law)
"""Laws of a servo; the first is the default of files that name none."""


@dataclass(frozen=True)
class FittedEffect:
    """An effect of the catalogue in a model, with the values of its parameters."""

    effect: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class JointModel(NotebookDisplay):
    """One servo: torque = kp (command(t - latency) - position) - kd velocity, within its limits.

    Attributes:
        law: ``"pd"``, the linear law above; ``"motor"``, which adds a motor with a torque-speed
            line and gears with friction (``servo.motor``); or ``"current_limited"``, that motor
            with a limit that is the same at any speed. Its ``no_load_speed_rad_s`` is then no
            property of the data sheet, but the speed at which the damping alone takes up the
            ``stall_torque_Nm``.
        motor: Parameters of the motor's law, by name; empty for ``"pd"``.
        kp_Nm_per_rad: Proportional gain; in 1/s2, per kg m2, if ``per_inertia``.
        kd_Nms_per_rad: Derivative gain; in 1/s, per kg m2, if ``per_inertia``.
        latency_s: Time from sending a set-point to its effect.
        inertia_kgm2: Moment of inertia of the load, without the rotor; 1 if ``per_inertia``.
        per_inertia: Whether gains are per unit of inertia, because the load is not known.
        load: The load stated by the recordings, if any.
        interval: Interval by parameter, of ``Model.interval_level``; an end is infinite where the
            data do not constrain it.
        correlation: Correlation of the estimates by pair, ``"a, b"``.
        standard_error: Standard error of each parameter that was fitted, in its unit; infinite
            where the data do not constrain it. Empty in files of earlier versions.
        effects: Effects in addition to the law.
        by_prior: Names of fitted parameters that the prior determines, and not the recordings.
        notes: Remarks on these values, one sentence each.
    """

    kp_Nm_per_rad: float
    kd_Nms_per_rad: float
    latency_s: float
    inertia_kgm2: float
    per_inertia: bool = False
    law: Law = "pd"
    motor: Mapping[str, float] = field(default_factory=dict)
    load: Load | None = None
    interval: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    correlation: Mapping[str, float] = field(default_factory=dict)
    standard_error: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[FittedEffect, ...] = ()
    notes: tuple[str, ...] = ()
    by_prior: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """All parameters by name, in SI units."""
        found = {name: vars(self)[name] for name in (*_GAINS, "inertia_kgm2")}
        found |= {f"motor.{name}": value for name, value in self.motor.items()}
        for effect in self.effects:
            found |= {f"{effect.effect}.{name}": x for name, x in effect.parameters.items()}
        return found

    @property
    def covariance(self) -> DataFrame:
        """Covariance of the F fitted parameters (F, F), in products of their units.

        ``standard_error`` and ``correlation``; infinite or NaN where the data constrain none.
        """
        error = self.standard_error
        covariance = DataFrame(0.0, index=list(error), columns=list(error))
        for a, b in product(error, error):
            correlation = self.correlation.get(f"{a}, {b}", self.correlation.get(f"{b}, {a}", 0.0))
            covariance.loc[a, b] = error[a] * error[b] * (1.0 if a == b else correlation)
        return covariance


@dataclass(frozen=True)
class Model(NotebookDisplay):
    """The fitted model of a robot.

    Attributes:
        joints: Servos by joint name.
        body: Fitted body: ``normalised_density`` and ``effects``; empty before calibration.
        effects: Effects of the supply or the link, shared by all joints.
        fit: Statistics of each signal (``j1.position_rad``): ``train`` and ``heldout`` root mean
            square error, ``noise`` and others, in the unit of the signal.
        notes: Remarks on the whole model, one sentence each.
        provenance: Command line, versions, seed and SHA-256 of the inputs.
        arm: The rigid bodies that load the servos of an arm.
        firmware_p_gain: Gain of the firmware to which kp belongs; None where it is not known.
        interval_level: Probability of the intervals.
        residuals: Measured less simulated angles of the samples that ``identify`` fitted, with
            columns ``joint``, ``recording``, ``t_s`` and ``residual_rad``; None of another model,
            and of a file, which does not keep them.
    """

    joints: Mapping[str, JointModel]
    body: Mapping[str, Any] = field(default_factory=dict)
    effects: tuple[FittedEffect, ...] = ()
    fit: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    arm: Arm | None = None
    firmware_p_gain: float | None = None
    interval_level: float = LEVEL
    residuals: DataFrame | None = field(default=None, repr=False, compare=False)

    @property
    def covariance(self) -> dict[str, DataFrame]:
        """Covariance of the fitted parameters of each joint."""
        return {name: joint.covariance for name, joint in self.joints.items()}

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each joint, by their names, in SI units.

        The columns are ``value``, ``low`` and ``high``, the ends of its interval, and
        ``standard_error``; NaN where there is none.
        """
        rows = [
            (name, key, value, *joint.interval.get(key, (nan, nan)), joint.standard_error.get(key))
            for name, joint in self.joints.items()
            for key, value in joint.values.items()
        ]
        columns = ["joint", "parameter", "value", "low", "high", "standard_error"]
        return DataFrame(rows, columns=columns).set_index(columns[:2]).astype(float)

    def plot(self) -> Drawing:
        """Gains and latency of every joint, with intervals."""
        figure: Drawing = from_report("identification.parameter_figure")(self)
        return figure


def train_rotor(effects: Sequence[FittedEffect]) -> float:
    """Inertia of the rotor in kg m2 that a gear train among the effects states, or 0."""
    values = {e.effect: e.parameters.get(_ROTOR, 0.0) for e in effects}
    return values.get("backlash", 0.0) or values.get("compliance", 0.0)


def with_inertia(effects: Sequence[FittedEffect], added: float) -> tuple[FittedEffect, ...]:
    """The effects, with so much more inertia in kg m2 that the stated load leaves out."""
    others = tuple(e for e in effects if e.effect != _LEFT_OUT)
    before = sum(e.parameters.get("inertia_kgm2", 0.0) for e in effects if e.effect == _LEFT_OUT)
    return (*others, FittedEffect(_LEFT_OUT, {"inertia_kgm2": before + added}))


def write_model(model: Model, path: str | os.PathLike[str]) -> None:
    """Write ``MODEL.json``; an infinite end of an interval is written as null."""
    content = {"schema": SCHEMA, _ROTOR_IN_LOAD: False, **vars(model)}
    content["joints"] = {}
    for name, joint in model.joints.items():
        one = content["joints"][name] = {**vars(joint), "load": joint.load and vars(joint.load)}
        for key in ("per_inertia", "motor", "load", "by_prior", "standard_error"):
            if not one[key]:
                del one[key]
        ends = {
            key: [end if math.isfinite(end) else None for end in pair]
            for key, pair in joint.interval.items()
        }
        one |= {"interval": ends, "effects": [vars(effect) for effect in joint.effects]}
    content["effects"] = [vars(effect) for effect in model.effects]
    content["arm"] = model.arm and arm_content(model.arm)
    del content["residuals"]
    write_json(path, {key: x for key, x in content.items() if x is not None})


def read_model(path: str | os.PathLike[str]) -> Model:
    """Read ``MODEL.json``, of earlier versions as well (``docs/reference/files.md``)."""
    top = Fields(path, "", read_json(path, SCHEMA))
    joints, fit = top.table("joints"), top.table("fit")
    servos = {name: _read_joint(joints.table(name)) for name in joints.labels()}
    level = top.number("interval_level", LEVEL, above=0)
    if level >= 1:
        raise top.error("interval_level", "a number between 0 and 1")
    for name, joint in servos.items():
        rotor = train_rotor(joint.effects)
        if rotor and top.content.get(_ROTOR_IN_LOAD, True):
            # The same motion, where the rotor of a gear train adds to the stated load's inertia.
            effects = with_inertia(joint.effects, joint.motor.get(_ROTOR, 0.0) - rotor)
            motor = {key: value for key, value in joint.motor.items() if key != _ROTOR}
            servos[name] = replace(joint, motor=motor, effects=effects)
    statistics = {}
    for signal in fit.content:
        one = fit.table(signal)
        figures = one.content.items()
        statistics[signal] = {
            name: None if x is None else one.number(name, infinite=True) for name, x in figures
        }
    return Model(
        joints=servos,
        body=_read_body(top.table("body")),
        effects=_read_effects(top),
        fit=statistics,
        notes=top.sentences("notes"),
        provenance=top.table("provenance").content,
        arm=arm_from(top.table("arm")) if "arm" in top else None,
        firmware_p_gain=top.optional_number("firmware_p_gain", above=0),
        interval_level=level,
    )


def _read_joint(fields: Fields) -> JointModel:
    law: Any = fields.choice("law", LAWS, LAWS[0])
    motor = fields.table("motor")
    if law == LAWS[0] and motor.content:
        raise fields.error("motor", "no such table where the law is pd")
    if 0 < motor.number("loop_period_s", 0.0) < SHORTEST_PERIOD_S:
        raise motor.error("loop_period_s", f"0 or at least {SHORTEST_PERIOD_S:g} s")
    interval = fields.table("interval")
    return JointModel(
        **{name: fields.number(name, low=0) for name in _GAINS},
        inertia_kgm2=fields.number("inertia_kgm2", above=0),
        per_inertia=fields.flag("per_inertia"),
        law=law,
        motor=motor.all_numbers(low=0),
        load=read_load(fields.table("load")) if "load" in fields else None,
        interval={name: _read_interval(interval, name) for name in interval.content},
        correlation=fields.table("correlation").all_numbers(),
        standard_error=fields.table("standard_error").all_numbers(low=0, infinite=True),
        effects=_read_effects(fields),
        notes=fields.sentences("notes"),
        by_prior=fields.sentences("by_prior"),
    )


def _read_body(fields: Fields) -> Mapping[str, Any]:
    """The content of the body's table, after a check of all fields that are read anywhere."""
    for name in ("twin", "water", "seems"):
        fields.table(name).all_numbers()
    for name in ("normalised_density", "normalised_density_sd"):
        if name in fields:
            low = 0.0 if name.endswith("_sd") else math.ulp(0.0)
            fields.numbers(name, "a list of numbers, one for each link", low=low)
    links = fields.table("twin_links")
    for name in links.content:
        links.numbers(name, "a list of sizes in m, one for each link", low=0.0)
    interval = fields.table("interval")
    for name in interval.content:
        _read_interval(interval, name)
    _read_effects(fields)
    if fields.content.get("posterior") is not None:
        posterior = fields.table("posterior")
        names, rows = (posterior.content.get(name) for name in ("names", "covariance"))
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise posterior.error("names", "a list of names")
        size = len(names)
        posterior.numbers("mean", f"{size} numbers", size)
        expected = f"{size} rows of {size} numbers"
        if not isinstance(rows, list) or len(rows) != size:
            raise posterior.error("covariance", expected)
        for row in (Fields(fields.file, posterior.where, {"covariance": row}) for row in rows):
            row.numbers("covariance", expected, size)
    return fields.content


def _read_interval(fields: Fields, name: str) -> tuple[float, float]:
    ends = fields.content[name]
    if isinstance(ends, list) and len(ends) == 2:
        low = -math.inf if ends[0] is None else finite_number(ends[0], infinite=True)
        high = math.inf if ends[1] is None else finite_number(ends[1], infinite=True)
        if low is not None and high is not None and low <= high:
            return low, high
    raise fields.error(name, "two numbers, the smaller first (null for an infinite end)")


def _read_effects(fields: Fields) -> tuple[FittedEffect, ...]:
    effects = []
    for entry in fields.tables("effects") if fields.content.get("effects") else []:
        values = entry.table("parameters").all_numbers(infinite=True)
        effects.append(FittedEffect(entry.text("effect"), values))
    return tuple(effects)
