"""The skin over the joints is viscoelastic: its spring force relaxes with time.

A spring in series with a damper at each joint (Maxwell element of a standard linear solid): the
strain of the spring decays with the time constant ``relaxation_s``. Confused with: elasticity or
damping alone; slow and fast strokes distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="a viscoelastic skin",
    title="the skin over the joints acts as a spring that relaxes with time",
    parameters=(
        Parameter("stiffness_Nm_per_rad", low=0.0, high=10.0, typical=0.3),
        Parameter("relaxation_s", low=0.02, high=5.0, typical=0.3),
    ),
    adds=lambda _robot, p, _material: {
        "skin": (0, 0, p["stiffness_Nm_per_rad"], p["relaxation_s"])
    },
    order=2,
)
