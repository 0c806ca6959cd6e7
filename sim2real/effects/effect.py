"""What an effect is: named parameters, the place in the servo where it acts, and its term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Site = Literal["inertia", "motor", "load", "friction", "sensor"]
"""Where a term acts, and so what it is given and gives back (all float64, SI).

========  ===============================================  =====================================
site      term                                             gives
========  ===============================================  =====================================
inertia   ``term(p, c)``                                   inertia on the shaft, added
motor     ``term(torque, q, v, p, c)``                     the torque that the motor really makes
load      ``term(q, v, p, c)``                             torque on the shaft, added
friction  ``term(q, v, torque, p, c)``                     largest torque of dry friction, added
sensor    ``term(q, v, p, c)``                             the angle that is measured
========  ===============================================  =====================================

``p`` is the row of all parameters of the joint and ``c`` the column of the effect's first one.
"""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: Its fixed name, the unit at its end.
        low: Smallest value that means anything.
        high: Largest value that means anything.
        typical: A value often met on servos of this class.
    """

    name: str
    low: float
    high: float
    typical: float


@dataclass(frozen=True)
class Effect:
    """A piece of physics that the plain PD servo leaves out.

    An effect is absent while all its parameters are 0.

    Attributes:
        name: Its fixed identifier.
        site: Where its term acts.
        term: The term, a Warp function (see ``Site``).
        parameters: Its parameters, in the order of their columns.
    """

    name: str
    site: Site
    term: Any
    parameters: tuple[Parameter, ...]
