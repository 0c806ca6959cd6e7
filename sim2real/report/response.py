"""Step response of a servo from its fitted parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim2real.model import JointModel


@dataclass(frozen=True)
class StepResponse:
    """Response of a servo to a small step of its command.

    Attributes:
        natural_frequency_rad_s: Undamped natural frequency.
        damping_ratio: 1 is critical damping.
        half_time_s: Time from sending the step to half of it, latency included.
        overshoot: Overshoot of the first swing as a share of the step.
    """

    natural_frequency_rad_s: float
    damping_ratio: float
    half_time_s: float
    overshoot: float


def step_response(joint: JointModel) -> StepResponse | None:
    """Response of the PD servo, without further effects; None if the stiffness is not positive.

    With inertia I and the torque m g l of a horizontal pendulum, w^2 = (kp + m g l) / I and
    zeta = kd / (2 I w), for small angles about the vertical; overshoot is
    exp(-pi zeta / sqrt(1 - zeta^2)) (K. Ogata, Modern Control Engineering, section 5-3).
    """
    gravity = joint.load.gravity_Nm if joint.load and not joint.per_inertia else 0.0
    stiffness = joint.kp_Nm_per_rad + gravity
    if stiffness <= 0:
        return None
    frequency = math.sqrt(stiffness / joint.inertia_kgm2)
    damping = joint.kd_Nms_per_rad / (2 * joint.inertia_kgm2 * frequency)
    overshoot = 0.0
    if damping < 1:
        overshoot = math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    half = joint.latency_s + _half_time(damping) / frequency
    return StepResponse(frequency, damping, half, overshoot)


def describe_response(name: str, joint: JointModel) -> str:
    """One or two sentences on the response time and settling of ``name``."""
    response = step_response(joint)
    if response is None:
        return f"With kp at 0, {name} does not follow its command."
    half, latency = 1e3 * response.half_time_s, 1e3 * joint.latency_s
    frequency, damping = response.natural_frequency_rad_s, response.damping_ratio
    return (
        f"{name} reaches half of a small step {half:.0f} ms after it is sent, of which "
        f"{latency:.0f} ms is latency. Its natural frequency is {frequency:.3g} rad/s "
        f"({frequency / (2 * math.pi):.2g} Hz) and its damping ratio {damping:.2f}: "
        f"{_settling(response)}."
    )


def _settling(response: StepResponse) -> str:
    if response.damping_ratio == 0:
        return "it oscillates and does not settle"
    if response.damping_ratio >= 1:
        return "it does not overshoot"
    if response.overshoot < 0.005:
        return "it hardly overshoots"
    return f"it overshoots a step by {100 * response.overshoot:.0f} %"


def _half_time(damping: float) -> float:
    """Time to half of a unit step, in units of one over the natural frequency."""
    from scipy.optimize import brentq  # slow to load; tables of fits do not need it

    before_the_peak = math.pi / math.sqrt(1 - damping**2) if damping < 0.9 else 4 * damping + 4
    return float(brentq(lambda time: _unit_step(time, damping) - 0.5, 0.0, before_the_peak))


def _unit_step(time: float, damping: float) -> float:
    if abs(damping - 1) < 1e-6:
        return 1 - (1 + time) * math.exp(-time)
    if damping < 1:
        swing = math.sqrt(1 - damping**2)
        turn = math.cos(swing * time) + damping / swing * math.sin(swing * time)
        return 1 - math.exp(-damping * time) * turn
    fast = -damping - math.sqrt(damping**2 - 1)
    slow = 1 / fast  # the product of the poles is 1; a difference would lose precision
    return 1 - (fast * math.exp(slow * time) - slow * math.exp(fast * time)) / (fast - slow)
