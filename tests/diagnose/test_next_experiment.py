"""What to record next: it tells rivals apart, keeps within reach, and can be played."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import INERTIA

from sim2real.diagnose.page.next_experiment import _CLEAR, next_experiment, write_commands
from sim2real.diagnose.result import Diagnosis
from sim2real.model import JointModel, Model
from sim2real.recording import Load, read_recording

REACH = 0.8


def planned(searched, *members):
    tried = searched.tried
    sets = [frozenset({name}) for name in members]
    # What explains little at first sight was not followed.
    missing = [s for s in sets if s not in tried.tried]
    jobs = [(tried, s, searched.search.start(tried, frozenset())) for s in missing]
    for found in searched.search.refit(jobs) if jobs else ():
        tried.keep(found)
    rivals = [tried.tried[s] for s in sets]
    return next_experiment(searched.traces[0], rivals, members, "j1", REACH)


@pytest.fixture(scope="module")
def apart(rubbing):
    """Dry friction and a rotor: very different things."""
    return planned(rubbing, "coulomb_friction", "unmodelled_inertia")


def test_rivals_that_differ_are_told_apart(apart):
    assert apart.separation > _CLEAR
    assert apart.context == "none", "no change of context is asked for without need"
    assert apart.separates == ("coulomb_friction", "unmodelled_inertia")
    assert "j1" in apart.statement
    assert apart.command in apart.statement


def test_the_command_can_be_played(apart):
    assert np.abs(apart.signal).max() <= REACH + 1e-12
    assert (np.diff(apart.t) > 0).all()
    assert apart.signal.shape == apart.t.shape
    assert apart.t[-1] == apart.duration_s


def test_two_filters_are_no_further_apart_than_friction_and_rotor(filtered, apart):
    found = planned(filtered, "command_filter", "sensor_filter")
    assert 0 <= found.separation < apart.separation


def test_a_rival_is_no_distance_from_itself(rubbing):
    rival = rubbing.tried.tried[frozenset({"coulomb_friction"})]
    members = ("coulomb_friction", "coulomb_friction")
    found = next_experiment(rubbing.traces[0], [rival, rival], members, "j1", REACH)
    assert found.separation < 0.1
    assert "a second sensor would" in found.statement


def test_one_alone_needs_no_experiment(rubbing):
    assert planned(rubbing, "coulomb_friction") is None


def diagnosed(experiment):
    model = Model({"j1": JointModel(2.2, 0.06, 0.05, INERTIA, load=Load(INERTIA))})
    return Diagnosis(
        verdict="ambiguous", mismatch=(), effects=(), rivals=(), unknown={},
        baseline_fit={}, enriched_fit={}, ladders={},
        detection_limits=(), next_experiment=experiment, gate=(), model=model,
    )  # fmt: skip


def test_it_is_written_as_commands_to_record(apart, tmp_path):
    written = write_commands(diagnosed(apart), tmp_path / "diagnosis.json")
    commands = read_recording(tmp_path / written.next_experiment.file)
    assert commands.joints == ("j1",)
    np.testing.assert_allclose(commands.command[:, 0], apart.signal, atol=1e-6)
    np.testing.assert_allclose(commands.t, apart.t, atol=1e-6)
    assert np.isnan(commands.position).all()


def test_a_change_of_load_stands_in_the_file(apart, tmp_path):
    for context, inertia, gravity in (
        ("added_weight", INERTIA, 0.0),
        ("added_inertia", INERTIA, -1),
    ):
        changed = replace(apart, context=context)
        written = write_commands(diagnosed(changed), tmp_path / f"{context}.json")
        load = read_recording(tmp_path / written.next_experiment.file).loads["j1"]
        assert load.inertia_kgm2 > inertia
        assert load.gravity_Nm > gravity
