"""Definition of an effect of a servo: its parameters, the site where it acts, and its term."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import warp as wp  # with F and Row the language of terms, for all effects

from sim2real.inference.parameters import Parameter
from sim2real.units import readable

F = wp.float64
"""A number, in the signature of a term."""
Row = wp.array(dtype=wp.float64)
"""A row of numbers: a joint's parameters or its memory."""
Table = wp.array2d(dtype=wp.float64)
"""A row of numbers for each rollout."""

Site = Literal["arrival", "command", "error", "motor", "load", "friction", "inertia", "sensor"]
"""Sites where terms act, from the sent command to the measured angle.

Every term is a Warp function of the same form, ``x = term(x, q, v, torque, time, h, p, c, z, s)``:
its input x is that of the site and its result replaces x. All numbers are float64, SI.

========  =====================================================  ==================
site      x                                                      called
========  =====================================================  ==================
arrival   time at which a set-point takes effect                 for each set-point
command   set-point in force, rad                                each sub-step
error     set-point minus angle in the controller, rad           each sub-step
motor     torque of the motor, N m                               each sub-step
load      other torque on the shaft, N m                         each sub-step
friction  largest torque of dry friction, N m                    each sub-step
inertia   inertia on the shaft, kg m2                            once
sensor    measured angle, rad                                    each sub-step
========  =====================================================  ==================

``q`` and ``v`` are the shaft's angle and speed, ``torque`` the motor's, ``time`` the seconds since
the start, ``h`` the length of the sub-step. ``p`` is the joint's row of parameters and ``c`` the
column of the effect's first one; ``z`` is the joint's memory and ``s`` the effect's first cell of
it, initially 0. At ``arrival``, ``time`` is when the set-point was sent and ``q`` its number.
"""


STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Starting values of the first parameter of an effect in fits, in typical values."""
LIMITS = (*STRENGTHS, 30.0)
"""Starting values of a limit, which has little effect if it is large."""
SIGNED = (-2.0, -0.3, 0.3, 2.0)
"""Starting values of parameters with either sign."""
SHAPES = (0.4, 1.0, 2.5)
"""Starting values of further parameters."""


def is_limit(parameter: Parameter) -> bool:
    """Whether an effect is weak if this parameter is large."""
    return parameter.starts == LIMITS


def scaled(parameter: Parameter, kp_Nm_per_rad: float, inertia_kgm2: float) -> Parameter:
    """A parameter scaled to a servo with another gain and load.

    The catalogue states parameters for a hobby servo of 2 N m/rad with a load of 0.002 kg m2.
    """
    size = 1.0
    if "per_Nm" in parameter.name:
        size = 2.0 / kp_Nm_per_rad
    elif "Nm" in parameter.name:
        size = kp_Nm_per_rad / 2.0
    elif "kgm2" in parameter.name:
        size = inertia_kgm2 / 0.002
    ends = {name: getattr(parameter, name) * size for name in ("low", "high", "typical")}
    return replace(parameter, **ends)


class _Size(str):
    """A magnitude with its unit; formatted as ``a|b`` it is a for a positive value, else b."""

    positive: bool

    def __format__(self, choice: str) -> str:
        return choice.split("|")[not self.positive] if choice else str(self)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Physics that the plain PD servo omits.

    An effect is absent while all its parameters are 0.
    """

    name: str = ""  # its fixed identifier: the name of its file
    plain: str  # description for use in a sentence
    # the finding as a clause, with names of parameters in braces, which are replaced by magnitudes
    # with units; {name:a|b} is a where the parameter is positive, else b. If the words depend on
    # the values in another way, a function from the values to this clause
    says: str | Callable[[Mapping[str, float]], str]
    site: Site  # where its term acts
    term: Any  # the term, a Warp function (see ``Site``)
    parameters: tuple[Parameter, ...]  # its parameters, in the order of their columns
    component: Literal["joint", "supply", "link"] = "joint"  # the component that it belongs to
    memory: int = 0  # number of memory cells that it needs
    order: int = 0  # effects at one site act in ascending order, those of equal order by name
    family: str = ""  # effects of one family describe the same mechanism (see ``excludes``)
    also: tuple[tuple[Site, Any], ...] = ()  # further terms of the effect, each with its site
    # whether its term at the sensor has no state and is evaluated at samples only
    steady: bool = False
    # whether its parameters can be fitted; not if it is random for each set-point, or determined
    # directly from the recorded numbers
    fitted: bool = True
    # whether all servos have a small amount of it, which is then no finding
    everywhere: bool = False
    never_named: bool = False  # whether it is always part of the plain servo and never a finding
    either_sign: bool = False  # whether it may decrease as well as increase between recordings
    # column of the plain servo, from the stated load, that it corrects
    load: Literal["", "gravity_Nm", "inertia_kgm2"] = ""
    # names of two of its parameters of which the second is never below the first
    ascending: tuple[()] | tuple[str, str] = ()
    # effects of a single joint that this effect of the supply or the link resembles; with it, they
    # are no finding
    mimics: tuple[str, ...] = ()

    def excludes(self, other: Self) -> bool:
        """Whether a joint has at most one of the two.

        Effects of one family exclude each other at one site and on the shaft (load and friction):
        Coulomb friction is a special case of every other dry friction, and two dry frictions of one
        contact together imitate a third one. Before and behind the servo, two effects of one family
        are distinct.
        """
        shaft = ("load", "friction")
        near = self.site == other.site or (self.site in shaft and other.site in shaft)
        return self.name == other.name or bool(self.family) and self.family == other.family and near

    def statement(self, values: Mapping[str, float], *, per_inertia: bool = False) -> str:
        """The finding as a clause, from its parameters by name, SI, ``per_inertia`` or not."""
        template = self.says if isinstance(self.says, str) else self.says(values)
        sizes = {}
        for name, x in values.items():
            sizes[name] = _Size(readable(name, abs(x), per_inertia=per_inertia))
            sizes[name].positive = x > 0
        return template.format(**sizes)
