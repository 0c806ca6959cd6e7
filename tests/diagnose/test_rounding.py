"""A coarse sensor is read off the numbers; a fine or a changing one is none."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import traced

from sim2real.diagnose.case import coarse_step

STATED = 0.00419


def rounded(step, seeds=(1, 2)):
    traces = [traced(seed, str(seed)) for seed in seeds]
    return [replace(x, position=step * np.round(x.position / step)) for x in traces]


@pytest.mark.parametrize("step", [0.0087, 0.0123, 0.03])
def test_a_coarse_step_is_measured(step):
    assert coarse_step(rounded(step), STATED) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("step", [0.0005, STATED])
def test_a_step_as_stated_is_no_finding(step):
    assert coarse_step(rounded(step), STATED) is None


def test_angles_on_no_grid():
    assert coarse_step([traced(1)], STATED) is None


def test_all_recordings_must_agree():
    one, other = rounded(0.0123)[0], rounded(0.03)[1]
    assert coarse_step([one, other], STATED) is None
    assert coarse_step([one, traced(2)], STATED) is None


def test_missing_samples_do_not_hide_it():
    (trace,) = rounded(0.0123, seeds=(1,))
    used = np.arange(trace.t.size) % 7 != 0
    assert coarse_step([replace(trace, used=used)], STATED) == pytest.approx(0.0123, rel=1e-3)
