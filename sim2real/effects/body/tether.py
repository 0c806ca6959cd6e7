"""A cable pulls the head towards a point in the pool.

``force = stiffness (anchor - head)``. Confused with: a current; the end point of the swim
distinguishes them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="a tether",
    title="a cable pulls the head towards an anchor in the pool",
    parameters=(
        Parameter("stiffness_N_per_m", low=0.0, high=10.0, typical=0.1),
        Parameter("x_m", low=-10.0, high=10.0, typical=0.5),
        Parameter("y_m", low=-10.0, high=10.0, typical=0.5),
    ),
    adds=lambda _robot, p, _material: {"tether": (p["stiffness_N_per_m"], p["x_m"], p["y_m"])},
    order=9,
)
