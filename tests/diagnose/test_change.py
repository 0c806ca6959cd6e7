"""What has changed against references: the change by its name, not what was there before."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import INERTIA, NOISE, column, recording, traced
from test_diagnose import robot

from sim2real.diagnose.case import Case
from sim2real.diagnose.change import change, contrast, misstated, refined
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.diagnose import diagnose_all
from sim2real.diagnose.per_recording import Linear, gains, linearised
from sim2real.diagnose.references import with_known_servos
from sim2real.errors import InputError
from sim2real.recording import Load
from sim2real.servo.batch import Batch
from sim2real.servo.plain import baselines
from sim2real.servo.problem import Servos
from sim2real.servo.repeats import alignment, freed_of_the_common

RUBBING = {"coulomb_friction": {"torque_Nm": 0.03}}
FILTERED = {"command_filter": {"time_constant_s": 0.06}}
COUNT = 400
NAMES = ("kp_Nm_per_rad", "sensor_gain", "sensor_offset", "backlash")


def linear(sizes, seed=0, references=3, lacking=0.0):
    """One shared parameter and three effects, of these sizes, shape (R, 3), in white noise.

    ``lacking`` is how large the effects of missing physics are that differ from one to the next.
    """
    rng = np.random.default_rng(seed)
    grams = []
    for size in sizes:
        columns = rng.standard_normal((COUNT, len(NAMES)))
        strange = lacking * rng.standard_normal(3)
        residual = rng.standard_normal(COUNT) - columns[:, 1:] @ (np.array(size) + strange)
        rows = np.column_stack([residual, columns])
        grams.append(rows.T @ rows)
    count = np.full(len(sizes), float(COUNT))
    signed = np.array([True, True, True, True])
    none = np.zeros((1, 0))
    nobody = Servos(np.zeros(1, int), none, np.zeros((1, 0), int), none, none, none)
    return Linear(
        np.array(grams), count, references, 1, NAMES, signed, True, (), nobody, none, none
    )


NOTHING = [(0, 0, 0)] * 4
OFFSET = [(0, 0, 0)] * 3 + [(0, 2, 0)]


def test_gain_and_size_are_those_of_least_squares():
    given = linear(OFFSET)
    gain, size, left = gains(given, [3])
    rows = np.linalg.cholesky(given.gram[3] + 1e-9 * np.eye(5)).T
    x = np.linalg.lstsq(rows[:, [1, 3]], -rows[:, 0], rcond=None)[0]
    # The shared parameter is the references' as much as the case's.
    assert size[2] == pytest.approx(x[1], abs=0.1)
    assert size[2] == pytest.approx(2, abs=0.2)
    assert gain[2] == pytest.approx(0.5 * COUNT * np.log(1 + 2**2), rel=0.15)
    assert left[2] == pytest.approx(COUNT, rel=0.15)
    assert (gain >= 0).all()


def test_an_effect_that_cannot_be_negative_gains_nothing_backwards():
    given = replace(
        linear([(0, 0, 0)] * 3 + [(0, -2, 0)]), signed=np.array([True, True, False, True])
    )
    assert gains(given, [3])[0][2] == 0
    assert gains(linear([(0, 0, 0)] * 3 + [(0, -2, 0)]), [3])[0][2] > 100


def test_a_change_in_the_case_is_named():
    found = change(contrast(linear(OFFSET)))
    assert found.group.members == ("sensor_offset",)
    assert found.group.probability == pytest.approx(DECISION.most_certain)
    assert sum(found.probability.values()) > 0.99


def test_nothing_is_named_where_nothing_changed():
    for seed in range(20):
        found = change(contrast(linear(NOTHING, seed)))
        assert found.group.probability < 0.5


def test_what_differs_as_much_among_references_is_no_change():
    """Missing physics looks different in each recording; a gain in likelihood would accuse."""
    sure, gained = [], []
    for seed in range(20):
        weighed = contrast(linear(NOTHING, seed, lacking=1.0))
        sure.append(change(weighed).group.probability)
        gained.append(weighed.gain.max())
    assert np.min(gained) > 20
    assert np.mean(np.array(sure) > 0.5) <= 0.05


def test_a_servo_set_anew_gets_no_name():
    """Nothing else comes near what its own gain explains."""
    given = linear(NOTHING)
    column = given.gram[3].copy()
    column[0] -= 3 * column[1]
    column[:, 0] -= 3 * column[:, 1]
    gram = np.array([*given.gram[:3], column])
    found = change(contrast(replace(given, gram=gram)))
    assert found.probability["kp_Nm_per_rad"] > 0.9
    assert found.group.probability < 0.1


def test_other_motions_ask_for_more():
    weighed = contrast(linear([(0, 0, 0)] * 3 + [(0, 0.3, 0)]))
    sure = change(weighed).group.probability
    assert change(replace(weighed, repeated=False)).group.probability < 0.1 * sure


def test_what_no_effect_explains_gets_no_name():
    weighed = contrast(linear(OFFSET))
    alien = replace(weighed, energy=50.0, left=np.full(len(weighed.effects), 45.0))
    found = change(alien)
    assert found.group.probability < 0.1
    assert sum(found.probability.values()) < 0.1


def test_a_repeated_command_is_found_with_its_lag():
    one = traced(1, "a")
    late = replace(one, t=one.t + 0.1)
    assert alignment(one, late) == pytest.approx((0.1, 0), abs=2e-3)
    assert alignment(one, traced(2, "b"))[1] > 0.5


def test_what_repeats_share_is_taken_away():
    one, other = traced(1, "a"), traced(2, "b")
    bend = 0.05 * np.sin(one.t)
    residuals = [bend, bend + 0.01, np.zeros(other.t.size)]
    freed, there = freed_of_the_common([one, replace(one), other], residuals, 2)
    assert there.tolist() == [True, True, False]
    np.testing.assert_allclose(freed[0].position, one.position + bend + 0.01, atol=1e-6)
    assert freed[2] is other


def weighed(case, references):
    """The contrast of one joint, all as traces."""
    plain = baselines(Batch([[*references, *case]]))
    given = linearised(references, case, [plain.servos])
    return refined(contrast(given), given)


def test_friction_that_was_there_before_is_no_change():
    """A lag of commands is a lag of angles, too, to a servo that is nearly linear."""
    references = [traced(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2, 3)]
    same = change(weighed([traced(4, "a", seconds=8.0, **RUBBING)], references))
    assert same.group.probability < 0.5
    lagging = traced(4, "a", seconds=8.0, **RUBBING, **FILTERED)
    filtered = change(weighed([lagging], references))
    assert set(filtered.group.members) == {"command_filter", "sensor_filter"}
    assert filtered.group.probability > 0.5


@pytest.fixture(scope="module")
def found():
    """Diagnoses of an unchanged servo and of one with a filter, both with friction all along."""
    references = [recording(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2)]
    cases = [
        Case([recording(3, "a", seconds=8.0, **RUBBING, **more)], robot("j1"), None, references)
        for more in ({}, FILTERED)
    ]
    return diagnose_all(cases)


@pytest.mark.parametrize("right", [True, False])
def test_a_load_that_is_stated_wrong_is_told_from_one_that_changed(right):
    """Both cases state twice the inertia; only one of them has it."""
    before, stated = Load(INERTIA), Load(2 * INERTIA)
    references = [traced(k, f"ref_{k}", seconds=8.0, load=before) for k in (1, 2)]
    moved = traced(3, "a", seconds=8.0, load=stated if right else before)
    case = [replace(moved, load=stated)]
    plain = baselines(Batch([references]))
    servo = plain.servos
    found = misstated(references, case, [servo])
    assert found.effects == ("unmodelled_inertia",)
    assert found.gain < -50 if right else found.gain > 50
    assert found.theta[column("unmodelled_inertia.inertia_kgm2")] == pytest.approx(-INERTIA)
    assert misstated(references, [replace(moved, load=before)], [servo]) is None


def test_references_of_another_robot_are_refused():
    case = Case([recording(1, "a")], robot("j2"), references=[recording(2, "ref")])
    with pytest.raises(InputError):
        with_known_servos([case], np.random.default_rng(0))


def test_an_unchanged_servo_gets_no_name(found):
    assert found[0].verdict == "unchanged"
    assert found[0].effects == ()
    assert [e.effect for e in found[0].model.joints["j1"].effects] == ["coulomb_friction"]


def test_the_change_is_named_and_modelled(found):
    (effect,) = found[1].effects
    assert "command_filter" in effect.group
    assert effect.component == "j1"
    held = {e.effect for e in found[1].model.joints["j1"].effects}
    assert held == {"coulomb_friction", effect.effect}
    assert found[1].enriched_fit["j1.position_rad"]["train"] < 2 * NOISE
