"""Quadratic drag: a torque against the motion that grows with the square of the speed.

``torque = -coefficient v |v|`` (Morison's drag term for a turning plate), for instance of an arm in
water. Residual: a third harmonic at high speed. Confused with: a smaller kp and another latency,
which absorb three quarters of it; several amplitudes, or air against water, distinguish them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def drag(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x - p[c] * v * wp.abs(v)


EFFECT = Effect(
    plain="quadratic drag",
    says="a drag torque of {coefficient_Nms2} times the squared speed opposes the motion",
    site="load",
    term=drag,
    parameters=(Parameter("coefficient_Nms2", low=0.0, high=0.5, typical=0.01),),
)
