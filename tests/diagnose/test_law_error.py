"""Intervals of a gap are wider where the output rattles in it, which the law leaves out."""

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import column

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import law_error
from sim2real.servo.parameters import COLUMNS


def servo(*effects, output_friction_Nm=0.0):
    theta = np.zeros((1, len(COLUMNS)))
    theta[0, column("backlash.output_friction_Nm")] = output_friction_Nm
    fit = SimpleNamespace(servos=SimpleNamespace(theta=theta))
    return SimpleNamespace(members=frozenset(effects), fit=fit)


def test_a_gap_is_less_certain_where_friction_holds_the_motor_alone():
    rattling = servo("backlash", "coulomb_friction")
    assert law_error(rattling, "backlash") == DECISION.rattling_law_error > DECISION.law_error
    assert law_error(rattling, "coulomb_friction") == DECISION.law_error


@pytest.mark.parametrize(
    "held",
    [servo("backlash"), servo("backlash", "coulomb_friction", output_friction_Nm=0.02)],
)
def test_a_gap_whose_output_is_held_or_free_is_as_certain_as_any_effect(held):
    assert law_error(held, "backlash") == DECISION.law_error
