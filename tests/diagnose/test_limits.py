"""What could have been seen: in proportion to the noise, and true of an effect of that size."""

import numpy as np
import pytest
from simulated import NOISE, traced

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.screening import Screen, candidate, screen
from sim2real.diagnose.servo_search import baselines
from sim2real.diagnose.wording import detection_limits
from sim2real.effects import named
from sim2real.servo.batch import Batch

NEEDED = np.sqrt(2 * DECISION.detection_gain) + 1.28
EFFECTS = ("coulomb_friction", "sensor_gain", "backlash")


def limits_of(traces):
    batch = Batch([traces])
    given = [candidate(named(name), 2.2, 0.002) for name in EFFECTS]
    (seen,) = screen(batch, baselines(batch), [given])
    found = detection_limits(seen, given, "j1")
    return {limit.effect: next(iter(limit.smallest.values())) for limit in found}


@pytest.fixture(scope="module")
def usual():
    return limits_of([traced(1, "a"), traced(2, "b")])


def test_twice_the_noise_hides_twice_as_much(usual):
    noisy = limits_of([traced(1, "a", noise=2 * NOISE), traced(2, "b", noise=2 * NOISE)])
    for name in EFFECTS:
        assert noisy[name] == pytest.approx(2 * usual[name], rel=0.25)


def noticed(ratio, usual):
    """Of six robots with dry friction of so many limits, those on which it is noticed."""
    size = ratio * usual["coulomb_friction"]
    option = candidate(named("coulomb_friction"), 2.2, 0.002)
    traces = [
        [traced(10 * k + r, str(r), coulomb_friction={"torque_Nm": size}) for r in (1, 2)]
        for k in range(6)
    ]
    batch = Batch(traces)
    return sum(
        s.gain.max() > DECISION.detection_gain
        for s in screen(batch, baselines(batch), [[option]] * 6)
    )


def test_an_effect_well_above_its_limit_is_seen(usual):
    assert noticed(10.0, usual) >= 5


def made_up(strengths, visible):
    """A screen of one candidate whose starts are these strengths."""
    option = candidate(named("coulomb_friction"), 2.2, 0.002)
    object.__setattr__(option, "starts", np.asarray(strengths, dtype=float)[:, None])
    size = len(strengths)
    zero = np.zeros(size, dtype=int)
    seen = Screen(
        zero, np.arange(size), np.zeros(size), np.zeros((1, size)), np.asarray(visible), 1e3
    )
    ((_, value),) = detection_limits(seen, [option], "j1")[0].smallest.items()
    return value


@pytest.mark.parametrize(
    ("truth", "power"),
    [(0.012, 1), (0.03, 1), (0.1, 1), (0.012, 2), (0.03, 2), (0.1, 2), (0.005, 1), (0.05, -1)],
)
def test_between_strengths_it_is_interpolated_and_below_in_proportion(truth, power):
    """A score that falls with the strength is that of a limit."""
    strengths = np.array([0.01, 0.04, 0.16])
    assert made_up(strengths, NEEDED * (strengths / truth) ** power) == pytest.approx(truth)


def test_what_no_strength_shows_has_no_limit():
    assert made_up([0.01, 0.1], [0.1, 0.9 * NEEDED]) is None
