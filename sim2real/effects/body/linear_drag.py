"""Change of the drag that is proportional to the speed of the body.

``force = -coefficient v``, distributed over the links in proportion to their lengths. Confused
with: form drag, skin friction; slow and fast swims distinguish them.
"""

import numpy as np

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an error of the linear drag",
    title="change of the drag that is proportional to the speed of the body",
    parameters=(Parameter("coefficient", low=-5.0, high=20.0, typical=0.3, unit="N s/m"),),
    adds=lambda robot, p, _material: {
        "resist": np.outer(robot.lengths_m / robot.lengths_m.sum(), (p["coefficient"], 0, 0, 0))
    },
    order=4,
)
