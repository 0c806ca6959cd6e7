"""Priors of a servo: wide, with units."""

from __future__ import annotations

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.inference.parameters import Parameter, Priors
from sim2real.model import JointModel
from sim2real.servo.start import DAMPING_RATIO, FREQUENCY_RAD_S, LATENCY_S

RANDOM_EFFECTS = ("latency_jitter", "packet_loss")
"""Effects whose draws cannot be known from their parameters; they are held, not sampled."""


def servo_priors(joint: JointModel) -> Priors:
    """Wide priors of a servo's gains, latency and the effects that its model holds.

    Gains span natural frequencies of 2 to 300 rad/s and damping ratios of 0.05 to 4, each order of
    magnitude alike; latency is anything up to 0.3 s; an effect's parameters are anywhere within the
    limits that its file gives, for a servo of this strength.
    """
    inertia = joint.inertia_kgm2
    (slow, fast), (low, high) = FREQUENCY_RAD_S, DAMPING_RATIO
    units = ("1/s²", "1/s") if joint.per_inertia else ("", "")
    parameters = [
        Parameter("kp_Nm_per_rad", slow**2 * inertia, fast**2 * inertia, joint.kp_Nm_per_rad,
                  log=True, unit=units[0]),
        Parameter("kd_Nms_per_rad", 2 * low * slow * inertia, 2 * high * fast * inertia,
                  max(joint.kd_Nms_per_rad, 1e-9), log=True, unit=units[1]),
        Parameter("latency_s", *LATENCY_S, 0.05),
    ]  # fmt: skip
    for fitted in joint.effects:
        if fitted.effect in RANDOM_EFFECTS:
            continue
        for one in named(fitted.effect).parameters:
            p = scaled(one, joint.kp_Nm_per_rad, inertia)
            name = f"{fitted.effect}.{p.name}"
            parameters.append(Parameter(name, p.low, p.high, p.typical))
    return Priors(tuple(parameters))
