"""Integral action: the controller also integrates the error.

``torque += ki * integral of error``, while the torque is on. Residual: errors that decay over
seconds, and overshoot after long holds. Confused with: a viscoelastic skin or rubber; a long hold
under load distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def integral(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    error = (torque + p[1] * v) / p[0]  # what PD control made the torque of
    z[s] += h * error
    return x + p[c] * (z[s] - wp.float64(0.5) * h * error)  # its mean over the sub-step


EFFECT = Effect(
    plain="integral action of the controller",
    says="the controller has integral action with a gain of {ki_Nm_per_rad_s}",
    site="motor",
    term=integral,
    parameters=(Parameter("ki_Nm_per_rad_s", low=0.0, high=50.0, typical=2.0),),
    memory=1,
    order=-1,
)
