"""Sets of effects that stay open, and what a designed recording says of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from simulated import FRICTION, two

from sim2real.diagnose.open_sets import rival_sets, set_probabilities
from sim2real.diagnose.rival_sets import (
    design_of,
    read_rival_sets,
    separations,
    stated_sets,
    with_open_sets,
)
from sim2real.servo.parameters import COLUMNS
from sim2real.structured import Fields

DRY = "coulomb_friction"


@pytest.fixture(scope="module")
def rivals(explained_joint):
    _, (joint,) = explained_joint
    return rival_sets(joint.joint, joint.finding)


def designed(*pairs):
    """A recording that was to tell pairs of sets apart."""
    stated = [
        {"first": list(first), "second": list(second), "expected": 0.95} for first, second in pairs
    ]
    rivals = [{"component": "j1", "pairs": stated}]
    return replace(two(**FRICTION)[0], metadata={"rivals": rivals})


def test_the_sets_are_likely_and_their_probabilities_add_up(rivals):
    p = [one.probability for one in rivals.sets]
    assert sum(p) == pytest.approx(1.0)
    assert p == sorted(p, reverse=True)
    assert DRY in rivals.sets[0].effects
    assert 1 < len(rivals.sets) <= 14
    assert len({one.effects for one in rivals.sets}) == len(rivals.sets)


def test_what_is_known_of_parameters_is_what_the_fit_says(rivals):
    best = rivals.sets[0]
    sd = np.sqrt(np.diag(np.linalg.inv(best.information)))
    at = best.columns.tolist().index(COLUMNS.index(f"{DRY}.torque_Nm"))
    value = best.theta[best.columns[at]]
    assert value == pytest.approx(0.05, rel=0.2)
    assert abs(value - 0.05) < 4 * sd[at] < 0.05


def test_a_best_set_without_a_probability_leaves_sets_open(explained_joint):
    """Irregular timing may explain what the effects would; the plain servo is best then."""
    _, (joint,) = explained_joint
    finding = joint.finding
    assert finding.tried.base not in finding.posterior.sets
    rivals = rival_sets(joint.joint, replace(finding, best=finding.tried.plain))
    assert sum(one.probability for one in rivals.sets) == pytest.approx(1.0)


def test_they_survive_a_file_and_are_tried_again(rivals):
    content = rivals.content()
    (again,) = read_rival_sets(Fields("d.json", "", {"rival_sets": [content]}))
    assert again.content() == content
    recording = replace(two()[0], metadata={"rivals": [content]})
    stated = stated_sets([recording], "j1")
    assert [effects for effects, _ in stated] == [frozenset(one.effects) for one in rivals.sets]
    np.testing.assert_array_equal(stated[0][1][0], rivals.sets[0].theta[0])


def test_an_ordinary_recording_is_asked_what_an_earlier_diagnosis_left_open(rivals, tmp_path):
    file = tmp_path / "first.json"
    content = {"schema": "sim2real.diagnosis/1", "rival_sets": [rivals.content()]}
    file.write_text(json.dumps(content))
    first, second = with_open_sets(two(), file)
    assert stated_sets([first], "j1") == ()
    assert [effects for effects, _ in stated_sets([first, second], "j1")] == [
        frozenset(one.effects) for one in rivals.sets
    ]
    assert separations("j1", design_of([second], "j1"), {}) == ()
    file.write_text(json.dumps(content | {"rival_sets": []}))
    assert stated_sets(with_open_sets(two(), file), "j1") == ()
    bad = [replace(recording, metadata={"rivals": "no"}) for recording in two()]
    message(lambda: with_open_sets(bad, file), "rivals")
    other = content | {"rival_sets": [rivals.content() | {"component": "j9"}]}
    file.write_text(json.dumps(other))
    message(lambda: with_open_sets(two(), file), "first.json: rival_sets.component: found j9")


def test_expectation_and_outcome_stand_side_by_side(explained_joint):
    _, (joint,) = explained_joint
    recording = designed([(DRY,), ("deadband",)], [("deadband",), ("rate_limit",)])
    stated = design_of([recording], "j1")
    first, second = separations("j1", stated, set_probabilities(joint.joint, joint.finding))
    assert first.favoured == (DRY,)
    assert first.found > 0.9
    assert str(first).startswith("j1: expected to separate Coulomb friction from")
    assert "with 0.95; found Coulomb friction" in str(first)
    assert second.found is None
    assert str(second).endswith("both are ruled out.")


@pytest.mark.parametrize(
    ("stated", "place"),
    [
        ("no", "rivals"),
        ([{"sets": []}], "rivals[0].component"),
        ([{"component": "j1", "sets": [{"parameters": {"x": 1}}]}], "'x'"),
    ],
)
def test_rivals_of_another_form_are_refused_in_one_line(stated, place):
    bad = replace(two()[0], metadata={"rivals": stated})
    message(lambda: stated_sets([bad], "j1"), place)
