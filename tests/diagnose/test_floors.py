"""What stands beside the held-out error: knockoffs explain nothing, a black box explains a part."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import traced

from sim2real.diagnose.missing.screening import FITTED, candidate
from sim2real.diagnose.page import servo_knockoffs as knockoffs
from sim2real.diagnose.page.black_box import black_box
from sim2real.diagnose.page.servo_knockoffs import best_knockoff, changes
from sim2real.identification.held_out import held_out, splits
from sim2real.inference.folds import rms


class Floors:
    def __init__(self, traces, servo):
        (unseen,) = held_out([traces], [servo])
        given = [candidate(e, 2.2, 0.002) for e in FITTED if not e.everywhere]
        _, moved = changes(traces, servo, given)
        self.folds = splits(traces, unseen)
        self.plain = unseen.rmse
        self.knockoff = best_knockoff(traces, servo, moved, self.folds, np.random.default_rng(0))
        self.black_box = black_box(self.folds, np.random.default_rng(0))


@pytest.fixture(scope="module")
def clean(nothing):
    return Floors(nothing.traces, nothing.plain.servos)


@pytest.fixture(scope="module")
def rough(rubbing):
    return Floors(rubbing.traces, rubbing.tried.plain.fit.servos)


def test_splits_are_those_of_the_held_out_error(rough):
    residuals = [one.residual for fold in rough.folds for one in fold.scored]
    assert rms(residuals) == pytest.approx(rough.plain, rel=1e-3)


def test_a_knockoff_is_worth_nothing(clean, rough):
    assert clean.plain <= clean.knockoff < 1.05 * clean.plain
    assert rough.plain <= rough.knockoff < 1.3 * rough.plain


def test_an_effect_that_means_something_would_win_as_a_knockoff(rubbing, monkeypatch):
    """On equal terms with the real ones: what is no knockoff takes its error away."""
    monkeypatch.setattr(knockoffs, "meaningless", lambda response, t, rng: response)
    found = Floors(rubbing.traces, rubbing.tried.plain.fit.servos)
    assert found.knockoff < 0.6 * found.plain


def test_a_black_box_explains_friction_that_it_has_no_name_for(rough):
    assert rough.black_box < 0.5 * rough.plain


def test_a_black_box_finds_nothing_where_nothing_is(clean):
    assert clean.black_box == pytest.approx(clean.plain, rel=0.02)


def test_of_a_lone_recording_the_end_is_predicted(rubbing):
    lone = Floors(rubbing.traces[:1], rubbing.tried.plain.fit.servos)
    assert lone.knockoff > 0.9 * lone.plain
    assert lone.black_box < 0.8 * lone.plain


def test_the_black_box_never_sees_what_it_is_scored_on(rough):
    """What it adds, ``x``, is the same whatever was measured: mean of (x - c)2, (x + c)2 and x2."""
    c = 0.05

    def error2(shift):
        folds = [
            replace(f, scored=tuple(replace(o, trace=shifted(o, shift)) for o in f.scored))
            for f in rough.folds
        ]
        return black_box(folds, np.random.default_rng(0)) ** 2

    def shifted(one, shift):
        return replace(one.trace, position=one.angle + shift)

    left, middle, right = (error2(shift) for shift in (-c, 0.0, c))
    assert middle > 1e-6
    assert (left + right) / 2 - c**2 == pytest.approx(middle, rel=1e-9)


def test_missing_samples_are_neither_fitted_nor_scored(rubbing):
    servo = rubbing.tried.plain.fit.servos
    whole = traced(1, "a", coulomb_friction={"torque_Nm": 0.05})
    used = np.arange(whole.t.size) % 10 != 0
    gappy = replace(whole, used=used, position=np.where(used, whole.position, np.nan))
    found = Floors([gappy, rubbing.traces[1]], servo)
    assert np.isfinite([found.knockoff, found.black_box]).all()
    assert found.black_box < 0.6 * found.plain
