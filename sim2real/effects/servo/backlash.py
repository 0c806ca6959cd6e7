"""Backlash: a gap between the motor and the output, which is measured.

Two masses and a dead zone with rigid flanks, dry friction on either side: ``servo.gear_train``,
after Nordin, Gutman, Automatica 38 (2002) 1633-1649, Sec. 2. ``control_on_output`` is 1 where the
controller sees the output's angle and speed, 0 where it sees the motor's, and 0.5 where it sees the
output's angle and the motor is damped, by its back-EMF, as in hobby servos.
``restitution`` is the ratio of the relative speeds after and before an impact of the flanks.
``output_friction_Nm`` acts on the output's side, and holds the output in the gap; the friction of
other effects acts on the motor's side. The angle is measured from the middle of the gap.
``rotor_inertia_kgm2`` is that of rotor and gears, reflected to the output; it adds to the stated
load and to the rotor of the motor's law. Where it is 0, the motor's side is what turns beyond the
stated load: the rotor of the motor's law and ``unmodelled_inertia``. If that is 0 too, the output
has no inertia, and crossing the gap does not change the motor's motion.

The terms below are those of an articulated robot, whose joints are one mass each. With r the
rotor's share of the total inertia J (``p[3]``, load and rotor), T the motor's torque and g the
weight of the load, the common centre moves as one body, and the motor leads the load by x (impacts
are inelastic here)::

    r (1 - r) J x'' = (1 - r) T - r g      while |x| < gap / 2, and when a flank separates
    motor's angle   = q + (1 - r) x        load's angle = q - r x

Residual: jumps of the size of the gap where the torque changes its sign; with friction on the
output, more Coulomb friction by kp gap / 2. Confused with: dead band, Coulomb friction; three
amplitudes distinguish them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import sine


@wp.func
def rotor_share(p: Row, c: int) -> F:
    """The rotor's share of the inertia; 1 where it is not known."""
    if p[c + 1] == wp.float64(0.0):
        return wp.float64(1.0)
    return wp.clamp(p[c + 1] / p[3], wp.float64(0.02), wp.float64(0.98))


@wp.func
def start(torque: F, p: Row, c: int, z: Row, s: int) -> None:
    """Flank that is in contact at the start."""
    if z[s + 3] == wp.float64(0.0):
        z[s] = wp.float64(0.5) * p[c] * wp.sign(torque)
        z[s + 2] = z[s]
        z[s + 3] = wp.float64(1.0)


@wp.func
def cross(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Torque of the motor in N m, which moves relative to the load while it crosses the gap."""
    start(torque, p, c, z, s)
    half = wp.float64(0.5) * p[c]
    share = rotor_share(p, c)
    load_share = wp.float64(1.0) - share
    before = z[s]
    one = wp.float64(1.0)
    per = h / (share * p[3])
    seen = load_share - wp.min(wp.float64(2.0) * p[c + 3], one)  # of the lead, by the controller
    felt = seen / (one + wp.float64(0.5) * h * p[1] / p[3])  # as the common motion gives way
    push = x - felt * p[0] * (before - z[s + 2])
    if load_share > wp.float64(0.0) and p[4] != wp.float64(0.0):
        push += share * p[4] * sine(q) / load_share
    damping = wp.float64(0.5) * per * felt * (p[1] + wp.float64(0.5) * h * p[0])
    speed = ((one - damping) * z[s + 1] + per * push) / (one + damping)  # trapezoidal
    place = before + wp.float64(0.5) * h * (z[s + 1] + speed)
    if wp.abs(place) >= half:
        place = wp.clamp(place, -half, half)
        speed = wp.float64(0.0)
    z[s] = place
    z[s + 1] = speed
    middle = wp.float64(0.5) * (before + place) - z[s + 2]
    return x - seen * (p[0] * middle + p[1] * (place - before) / h)


@wp.func
def play(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    start(torque, p, c, z, s)
    share = rotor_share(p, c)
    return x - share * z[s] - (wp.float64(1.0) - share) * z[s + 2]


@wp.func
def hold(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Largest torque of dry friction in N m, the output's included."""
    return x + p[c + 2]


NEGLIGIBLE_NM = 1e-4
"""Friction on the output below which it is not stated."""
EFFECT = Effect(
    plain="backlash",
    says=lambda p: (
        "the gear train has {gap_rad} of backlash, and friction of {output_friction_Nm} acts on "
        "its output"
        if p["output_friction_Nm"] > NEGLIGIBLE_NM
        else "the gear train has {gap_rad} of backlash"
    ),
    site="motor",
    term=cross,
    parameters=(
        Parameter("gap_rad", low=0.0, high=0.3, typical=0.03),
        Parameter("rotor_inertia_kgm2", low=4e-5, high=0.02, typical=4e-4, starts=(1.0,)),
        Parameter("output_friction_Nm", low=0.0, high=1.0, typical=0.02, starts=(0.0, 1.0)),
        Parameter("control_on_output", low=0.0, high=1.0, typical=1.0, starts=(0.0, 0.5, 1.0)),
        Parameter("restitution", low=0.0, high=0.95, typical=0.5, starts=(0.0,)),
    ),
    memory=4,
    order=1,
    also=(("sensor", play), ("friction", hold)),
    steady=True,
)
