"""What is known of one joint in the end: errors, parameters with their intervals, models."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import ROUNDING, Finding
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.torque_speed_line import with_stated_line
from sim2real.effects import CATALOGUE, named
from sim2real.effects.effect import is_limit
from sim2real.effects.servo.backlash import NEGLIGIBLE_NM
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference.correlated_noise import RESIDUAL_WANDER
from sim2real.inference.least_squares import rms
from sim2real.inference.normal import Z90
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.parameters import (
    COLUMNS,
    FIRST_COLUMN,
    INERTIA_LEFT_OUT,
    ROTOR_INERTIA,
    TRAIN_ROTORS,
    motor_of,
    stated,
)

_FRICTION = named("coulomb_friction").family
_OUTPUT_FRICTION = COLUMNS.index("backlash.output_friction_Nm")
_ROTOR_NOTE = (
    "{:.3g} kg m² turn in addition to the stated load: rotor and gears of a size that the data "
    "sheet makes likely, or a load that is stated too small; these recordings cannot tell."
)
_PLAIN_NOTE = (
    "the model is the plain one of identify, which predicts held-out data better than that with "
    "the effects."
)


@dataclass(frozen=True)
class JointFindings:
    """One joint."""

    joint: JointCase  # its recordings
    finding: Finding  # what it is missing
    enriched: Hypothesis  # the servo with what was found, negligible effects included
    offered: Hypothesis  # the servo of the enriched model, see ``calibrated_odds.offer``
    unseen: Mapping[Set, Unseen]  # errors on held-out data, if any, by the effects of a servo
    # simulated minus measured angles of the plain servo in rad, shape (R, T)
    before: Array = field(default_factory=lambda: np.zeros((0, 0)))
    after: Array = field(default_factory=lambda: np.zeros((0, 0)))  # those of the offered one
    # parameters of the plain servo as ``identify`` fits them, shape (P,)
    least_squares: Array = field(default_factory=lambda: np.zeros(0))
    robust: Array = field(default_factory=lambda: np.zeros(0))  # those of the offered one
    # the servo as ``identify`` fits it and its errors, where it predicts held-out data better
    identified: tuple[JointModel, Unseen] | None = None

    @property
    def name(self) -> str:
        """Of the joint."""
        return self.joint.name

    @property
    def signal(self) -> str:
        """Of the joint's angle."""
        return f"{self.name}.position_rad"

    @property
    def adds_effects(self) -> bool:
        """Whether the offered servo has effects that the plain one lacks."""
        changed = bool(self.finding.sizes) and self.offered is not self.finding.tried.plain
        return changed or self.offered.members != self.finding.tried.base

    def fit(self, *, enriched: bool) -> dict[str, float | None]:
        """Errors on fitted and on held-out data, and the noise, rad."""
        servo, rows = self.finding.tried.base, self.before
        if enriched:
            servo, rows = self.offered.members, self.after
        pairs = zip(rows, self.joint.traces, strict=False)
        train = rms([row[: t.t.size][t.used] for row, t in pairs])
        return {"train": train, "heldout": self._unseen(servo), "noise": self.joint.noise}

    def heldout(self) -> dict[str, float | None]:
        """Errors on held-out data, and the share of the removable that is removed."""
        plain, enriched = map(self._unseen, (self.finding.tried.base, self.enriched.members))
        if plain is None or enriched is None:
            return dict.fromkeys(("rmse_before", "rmse_after", "recoverable_removed"))
        removable = plain - min(self.floor, plain)
        removed = np.clip((plain - enriched) / removable, -1.0, 1.0) if removable > 0 else 0.0
        return {"rmse_before": plain, "rmse_after": enriched, "recoverable_removed": float(removed)}

    def _unseen(self, members: Set) -> float | None:
        unseen = self.unseen.get(members)
        if self.identified is not None and members == self.offered.members:
            unseen = self.identified[1]
        return None if unseen is None else unseen.rmse

    @property
    def floor(self) -> float:
        """Error that no model removes, rad: noise and the slow wander that a sensor may have."""
        return float(self.joint.noise * np.sqrt(1 + RESIDUAL_WANDER.share**2))

    @property
    def leaves_structure(self) -> bool:
        """Whether the offered servo leaves more than noise and slow wander, fitted or held out."""
        heldout = self.fit(enriched=True)["heldout"]
        unseen = 0.0 if heldout is None else (heldout / self.floor) ** 2
        # Irregular timing differs in each recording: no model removes its error.
        more = max(self.finding.excess, unseen) > DECISION.structured_excess
        return self.finding.link is None and more

    def model(self, *, enriched: bool) -> JointModel:
        """The offered servo, or the plain one, as ``identify`` fits them, on the stated line."""
        coarse = self.joint.step_rad
        rounding = () if coarse is None else (FittedEffect(ROUNDING, {"step_rad": coarse}),)
        if enriched and self.identified is not None:
            model, _ = self.identified
            said = self.model(enriched=False).notes + (_PLAIN_NOTE,) * self.adds_effects
            return replace(model, effects=(*model.effects, *rounding), notes=said)
        servo, theta = self.finding.tried.plain, self.least_squares
        if enriched and self.adds_effects:
            servo, theta = self.offered, self.robust
        if self.joint.servo is not None:
            theta = with_stated_line(self.joint.traces, self.joint.servo, theta)
        notes: tuple[str, ...] = ()
        members = servo.members
        values = dict(zip(COLUMNS, theta.tolist(), strict=True))
        rotor = float(theta[INERTIA_LEFT_OUT])
        in_base = UNMODELLED_INERTIA in self.finding.tried.base - self.joint.base
        if in_base and rotor > 0 and not theta[list(TRAIN_ROTORS)].any():
            theta = theta.copy()
            theta[[ROTOR_INERTIA, INERTIA_LEFT_OUT]] = rotor, 0.0
            members = members - {UNMODELLED_INERTIA}
            notes = (_ROTOR_NOTE.format(rotor),)
        stated_effects = [
            FittedEffect(name, {p.name: values[f"{name}.{p.name}"] for p in named(name).parameters})
            for name in sorted(members)
        ]
        given = self.joint.model.law if self.joint.model else "pd"
        law = given if motor_of(theta) and given != "pd" else None
        model = stated(theta, self.joint.traces[0].load, (*stated_effects, *rounding), law)
        return replace(model, notes=notes)

    def estimates(self, effect: str) -> dict[str, Estimate]:
        """Parameters of an effect with their spread, by name; empty where the fit has it not."""
        if effect in self.finding.sizes:
            return dict(self.finding.sizes[effect])
        link, step = self.finding.link, self.joint.step_rad
        first = named(effect).parameters[0].name
        if link is not None and effect in link.sizes:
            return {first: Estimate.normal(*link.sizes[effect], low=0.0)}
        if effect == ROUNDING and step is not None:
            return {first: Estimate.normal(step, 1e-9)}  # read off recorded numbers
        servos, variance = self.enriched.fit.servos, self.enriched.fit.variances
        other, estimates = partner(self.enriched.members, effect), dict[str, Estimate]()
        for k, column in enumerate(servos.columns[0]):
            owner, _, name = COLUMNS[column].partition(".")
            if owner != effect:
                continue
            mean = float(servos.theta[0, column])
            law = 0.0 if name.endswith("phase_rad") else law_error(self.enriched, effect) * mean
            sd = float(np.hypot(np.sqrt(variance[k]) * servos.unit[0, k], law))
            bounds = float(servos.low[0, k]), float(servos.high[0, k])
            if other is not None:  # the interval contains the values of both
                value = float(servos.theta[0, COLUMNS.index(f"{other}.{name}")])
                distinct = distinctness(self.finding.tried, self.enriched, effect, other)
                low, high = exchangeable_ends(mean, value, distinct)
                low, high = low - Z90 * law, high + Z90 * law
                sd = max(high - mean, mean - low) / Z90
                bounds = max(low, bounds[0]), min(high, bounds[1])
            estimates[name] = Estimate.normal(mean, sd, *bounds)
        for k, parameter in enumerate(named(effect).parameters if estimates else ()):
            value = float(servos.theta[0, FIRST_COLUMN[effect] + k])
            estimates.setdefault(parameter.name, Estimate.normal(value, 0.0))  # of its branch
        return estimates


def law_error(servo: Hypothesis, effect: str) -> float:
    """Relative error of an effect's law, which adds to the standard deviations of its parameters.

    Where friction holds the motor and not the output, the output rattles in the gap, and
    the fit has many minima.
    """
    frictions = {e.name for e in CATALOGUE if e.family == _FRICTION}
    rattles = servo.fit.servos.theta[0, _OUTPUT_FRICTION] < NEGLIGIBLE_NM
    if effect == "backlash" and rattles and not frictions.isdisjoint(servo.members):
        return DECISION.rattling_law_error
    return DECISION.law_error


def includes_zero(tried: Tried, servo: Hypothesis, effect: str) -> bool:
    """Whether the 90 % interval of an effect's size includes 0, where the effect is absent.

    The size is the effect's first parameter, or the larger one of two that ascend. Limits are
    absent where they are large, and never of size 0. Of effects that may be exchanged the
    likelihood ratio decides.
    """
    other = partner(servo.members, effect)
    if other is not None:
        return distinctness(tried, servo, effect, other) <= Z90
    known = named(effect)
    name = known.ascending[1] if known.ascending else known.parameters[0].name
    size = next(p for p in known.parameters if p.name == name)
    column = COLUMNS.index(f"{effect}.{name}")
    servos = servo.fit.servos
    free = np.flatnonzero(servos.columns[0] == column)
    if is_limit(size) or not free.size:
        return False
    sd = float(np.sqrt(servo.fit.variances[free[0]]) * servos.unit[0, free[0]])
    return abs(float(servos.theta[0, column])) <= Z90 * sd


def partner(members: Set, effect: str) -> str | None:
    """The effect of a set that may exchange its parameters with this one of it; None without one.

    The transfer functions of two filters in series commute: recordings of a servo without friction
    or limits determine the sum and the product of their time constants. A partner is of the same
    family, acts at another site and has the same parameters.
    """
    one, known = named(effect), [named(other) for other in sorted(members - {effect})]
    alike = (other for other in known if one.family and other.family == one.family)
    names = [p.name for p in one.parameters]
    return next((x.name for x in alike if [p.name for p in x.parameters] == names), None)


def distinctness(tried: Tried, servo: Hypothesis, effect: str, other: str) -> float:
    """Root of twice the gain in log-likelihood by two effects over the better one alone.

    Where only one is present about the size of a standard normal deviate (Wilks, Annals of
    Mathematical Statistics 9 (1938) 60-62). ``servo`` is the fit with both.
    """
    fewer = [tried.tried.get(servo.members - {name}, tried.plain) for name in (effect, other)]
    gain = servo.fit.loglikelihood[0] - max(h.fit.loglikelihood[0] for h in fewer)
    return float(np.sqrt(max(2 * gain, 0.0)))


def exchangeable_ends(mean: float, other: float, distinct: float) -> tuple[float, float]:
    """Ends of the 90 % interval of either of two positive parameters that may be exchanged.

    With (x - y)^2 = (x + y)^2 - 4 x y, where their sum is taken as known and their product has a
    relative standard deviation of ``1 / distinct``: it is 0 where one of the effects is absent.
    """
    total = mean + other
    square = (mean - other) ** 2 + Z90 * 4 * mean * other / max(distinct, 1e-9)
    apart = min(float(np.sqrt(square)), total)
    return 0.5 * (total - apart), 0.5 * (total + apart)
