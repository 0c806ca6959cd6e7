"""The recording that tells rivals apart: within the limits, in the context that tells most."""

import json
from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from rival_pair import PERIOD, RIVALS
from simulated import robot
from violations import violations

from sim2real.design.contexts import AS_IT_IS, Context
from sim2real.design.limits import limits_of
from sim2real.design.rivals import JointObjective
from sim2real.design.tell_apart import Request, design_for_rivals, forecast
from sim2real.recording import PER_INERTIA, read_recording, write_recording

SECONDS = 6.0
ASKED = Request(SECONDS, file="d.json")


def designed(rivals=RIVALS, contexts=(), **given):
    few = {"samples": 6e4} | given
    return design_for_rivals([rivals], robot("j1"), ASKED, contexts, **few)


@pytest.fixture(scope="module")
def plain():
    return designed()


def test_it_keeps_the_limits_and_can_be_played(plain, tmp_path):
    limits = limits_of(robot("j1"))
    command = plain.recording().command[:, 0]
    assert violations(command[None], limits) == [[]]
    assert command.size == round(SECONDS / PERIOD)
    write_recording(plain.recording(), tmp_path / "next.csv")
    again = read_recording(tmp_path / "next.csv")
    np.testing.assert_allclose(again.command[:, 0], command, atol=1e-6)
    assert again.metadata["rivals"] == json.loads(json.dumps([x.content() for x in plain.joints]))
    assert again.loads["j1"] == RIVALS.load


def test_what_is_stated_is_the_forecast_of_its_commands(plain):
    (joint,) = plain.joints
    again = forecast(JointObjective(RIVALS), joint.command)
    assert again.pairs == joint.pairs
    assert 0.5 <= joint.pairs[0].expected <= 1.0
    assert plain.informative
    assert "separate Coulomb friction from" in str(plain)


def test_a_context_is_asked_for_where_it_tells_more():
    # Almost without inertia nothing but the gain shows; a hundredfold noise hides it all.
    loud = replace(RIVALS, noise_rad=0.02)
    soft = Context("a quarter of the gain", gain=0.25)
    same = Context("the same once more", supply=1.0)
    found = designed(loud, [soft])
    assert found.setting == "context: a quarter of the gain"
    assert found.joints[0].remaining < designed(loud).joints[0].remaining
    assert designed(loud, [same]).setting == f"context: {AS_IT_IS.name}"


def test_where_nothing_can_be_told_it_says_so():
    found = designed(replace(RIVALS, noise_rad=5.0), samples=1.0)
    assert not found.informative
    assert str(found).startswith("Nothing more can be distinguished within these limits")


def test_another_robot_is_refused():
    message(lambda: design_for_rivals([RIVALS], robot("k1"), ASKED), "'j1'", "k1")


def test_a_load_is_known_of_all_recordings_or_of_none():
    unknown, arm = replace(RIVALS, load=PER_INERTIA), Context("arm", {"j1": RIVALS.load})
    message(lambda: designed(unknown, [arm]), "loads.j1", "one in all or in none")
    elsewhere = Context("arm", {"j7": RIVALS.load})
    message(lambda: designed(RIVALS, [elsewhere]), "'j7'")


def test_no_rivals_left_is_said_in_one_line():
    sure, other = RIVALS.sets
    sets = (replace(sure, probability=0.98), replace(other, probability=0.02))
    known = replace(RIVALS, sets=sets)
    message(lambda: design_for_rivals([known], robot("j1"), ASKED), "d.json", "rival_sets")
