"""Compliance: a spring between the motor and its load.

Two masses, a spring and a damper: ``servo.gear_train``, after Spong, Journal of Dynamic Systems 109
(1987) 310-318. The friction of other effects acts on the motor's side, and that of backlash on the
load's. ``sensor_on_output`` is 0 where the motor's angle is measured and 1 where the load's is;
``control_on_output`` is the same for the controller, see ``backlash``. ``damping_ratio`` is that of
the two masses on the spring, ``servo.gear_train.SPRING_DAMPING`` where it is 0.
``rotor_inertia_kgm2`` is that of rotor and gears, reflected to the output; it adds to the stated
load and to the rotor of the motor's law.

The terms below are those of an articulated robot, whose joints are one mass each, below the
resonance. With r the rotor's share of the total inertia (``p[3]``, load and rotor), T the motor's
torque and g the weight of the load, the spring transmits the torque on the load::

    F = (1 - r) T - r g                    motor's angle = q + (1 - r) compliance (F - F0)

where q is the angle of the common centre, which moves as one body, and F0 the spring's torque at
the start. With x the torque that PD control of q would command, the motor acts on load and spring
in series: ``T + (1 - r) compliance (kp (F - F0) + kd F') = x``; control of the load has ``-r`` in
place of ``1 - r``, which is 0 here.

Residual: an error proportional to torque, largest where it changes fast. Confused with: kp, kd, a
filter; a known additional inertia distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay, sine


@wp.func
def carried(torque: F, q: F, p: Row, c: int, z: Row, s: int) -> F:
    """Torque on the spring in N m, relative to that at the start."""
    share = wp.min(p[c + 1] / p[3], wp.float64(0.98))
    load = (wp.float64(1.0) - share) * torque
    if p[4] != wp.float64(0.0):
        load += share * p[4] * sine(q)
    if z[s + 1] == wp.float64(0.0):
        z[s] = torque
        z[s + 1] = wp.float64(1.0)
        z[s + 2] = load
    return load - z[s + 2]


@wp.func
def soften(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    load_share = wp.float64(1.0) - wp.min(p[c + 1] / p[3], wp.float64(0.98))
    passive = carried(x, q, p, c, z, s) - load_share * x  # spring's torque without the motor's
    seen = wp.min(wp.float64(2.0) * p[c + 3], wp.float64(1.0))
    give = wp.max(load_share - seen, wp.float64(0.0)) * p[c]
    share = wp.float64(1.0) + p[0] * give * load_share
    settled = (x - p[0] * give * passive) / share
    before = z[s]
    remaining = wp.float64(0.0)
    if p[1] * give > wp.float64(0.0):
        remaining = decay(h * share / (p[1] * give * load_share))
    z[s] = settled + (before - settled) * remaining
    return wp.float64(0.5) * (before + z[s])


@wp.func
def twist(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    load_share = wp.float64(1.0) - wp.min(p[c + 1] / p[3], wp.float64(0.98))
    return x + (load_share - p[c + 2]) * p[c] * carried(torque, q, p, c, z, s)


EFFECT = Effect(
    plain="compliance between motor and load",
    says=lambda p: (
        "motor and load are coupled by a spring with a compliance of {compliance_rad_per_Nm}; "
        + f"the sensor measures the {'load' if p['sensor_on_output'] > 0.5 else 'motor'}"
    ),
    site="motor",
    term=soften,
    parameters=(
        Parameter("compliance_rad_per_Nm", low=0.0, high=0.15, typical=0.02),
        Parameter("rotor_inertia_kgm2", low=4e-5, high=0.02, typical=4e-4, starts=(1.0,)),
        Parameter("sensor_on_output", low=0.0, high=1.0, typical=1.0, starts=(0.0, 1.0)),
        Parameter("control_on_output", low=0.0, high=1.0, typical=1.0, starts=(0.0,)),
        Parameter("damping_ratio", low=0.005, high=2.0, typical=0.05, starts=(1.0,)),
    ),
    memory=3,
    also=(("sensor", twist),),
    steady=True,
)
