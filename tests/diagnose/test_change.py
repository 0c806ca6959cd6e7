"""What has changed against references: the change by its name, not what was there before."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import INERTIA, NOISE, SHEET, column, recording, robot, row, steps, traced

from sim.commands.diagnose import write_all
from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.diagnose import diagnose, diagnose_case
from sim2real.diagnose.explained import alignment, beside_rest, explained, noise_of, way_of
from sim2real.diagnose.references import jump_windows, law_of, what_changed, with_known_servos
from sim2real.errors import InputError
from sim2real.recording import Load, read_recording
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import trace

RUBBING = {"coulomb_friction": {"torque_Nm": 0.03}}
FILTERED = {"command_filter": {"time_constant_s": 0.06}}
STEP = 0.00419


def test_a_repeated_command_is_found_with_its_lag():
    one = traced(1, "a")
    late = replace(one, t=one.t + 0.1)
    assert alignment(one, late) == pytest.approx((0.1, 0), abs=2e-3)
    assert alignment(one, traced(2, "b"))[1] > 0.5


def repeats(offset=0.0, *, more=None, noise=2e-5, bend=0.02):
    """Three recordings of one command by a servo with physics of its own; the last one changed."""
    every = []
    for k in range(3):
        changes = (more or {}) if k == 2 else {}
        given = recording(1, f"take_{k}", noise=0.0, **changes)
        rng = np.random.default_rng(k)
        own = bend * np.sin(3 * given.position) + rng.normal(0, noise, given.position.shape)
        shift = offset if k == 2 else 0.0
        every.append(replace(given, position=given.position + own + shift))
    return [trace(one, "j1") for one in every]


def test_a_repeat_shows_a_change_far_below_what_the_law_misses():
    a, b, case = repeats(offset=1e-3)
    assert way_of([a, b], [case]) == "repeat"
    found = what_changed([a, b], [case], row(), SHEET)
    (group,) = found.groups
    assert "sensor_offset" in group.members
    assert group.probability > 0.9
    assert found.row[column("sensor_offset.offset_rad")] == pytest.approx(1e-3, rel=0.1)
    same = what_changed([a, b], repeats()[2:], row(), SHEET)
    assert max(g.probability for g in same.groups) < 0.5
    assert same.nameless < 0.5


def test_a_repeat_shows_two_changes():
    a, b, case = repeats(offset=8e-3, more={"sensor_filter": {"time_constant_s": 0.02}})
    found = what_changed([a, b], [case], row(), SHEET)
    members = [set(group.members) for group in found.groups if group.probability > 0.5]
    assert len(members) == 2
    assert any("sensor_offset" in group for group in members)
    assert any({"sensor_filter", "command_filter"} & group for group in members)


@pytest.mark.parametrize(("halfwidth_s", "named"), [(0.0, False), (0.008, True)])
def test_a_link_that_jitters_since_shows_beside_repeats(halfwidth_s, named):
    before = [trace(wandering(k), "j1") for k in range(2)]
    case = wandering(2)
    late = np.random.default_rng(5).uniform(-halfwidth_s, halfwidth_s, case.t.size)
    arrived = np.interp(case.t + late, case.t, case.command[:, 0])  # what really came
    case = trace(replace(case, command=arrived[:, None]), "j1")
    found = what_changed(before, [case], row(), SHEET)
    assert (found.link is not None) == named
    if found.link is not None:
        assert found.groups[0].members == ("latency_jitter",)
        assert found.link.sizes["latency_jitter"][0] == pytest.approx(halfwidth_s, rel=0.5)


def wandering(seed):
    """A repeat of a smooth command, with fresh noise."""

    def command(t):
        return 0.5 * np.sin(2 * t) + 0.3 * np.sin(5 * t)

    return recording(seed, f"take_{seed}", 10.0, 5e-4, command=command)


def test_what_no_effect_does_has_no_name():
    a, b, case = repeats()
    strange = np.where((case.t > 4) & (case.t < 6), 0.03 * np.sin(9 * case.t), 0.0)
    found = what_changed([a, b], [replace(case, position=case.position + strange)], row(), SHEET)
    assert found.nameless > 0.5
    assert max(group.probability for group in found.groups) < 0.5


def test_a_horn_that_slips_is_a_jump_to_the_end():
    a, b, case = repeats()
    slipped = replace(case, position=case.position + np.where(case.t > 5, 0.05, 0.0))
    of = explained([a, b], [slipped], row(), STEP)
    ((window,),) = jump_windows(of, of.residual)
    assert window == pytest.approx((5.0, case.t[-1]), abs=0.05)
    assert what_changed([a, b], [slipped], row(), SHEET).nameless > 0.5
    of = explained([a, b], [case], row(), STEP)
    assert jump_windows(of, of.residual) is None


def test_what_was_sent_in_a_gap_is_not_held_against_the_servo():
    a, b, case = repeats()
    keep = np.ones(case.t.size, dtype=bool)
    keep[200:230] = False
    cut = replace(
        case, t=case.t[keep], command=case.command[keep], position=case.position[keep],
        used=case.used[keep],
    )  # fmt: skip
    of = explained([a, b], [cut], row(), STEP)
    soon = (cut.t > cut.t[200]) & (cut.t < cut.t[200] + 0.1)
    assert not of.traces[2].used[soon].any()
    assert what_changed([a, b], [cut], row(), SHEET).nameless < 0.5


def slow(levels, shift=0.0, gain=1.0, seed=0):
    """A servo sampled ten times a second that rests at its set-points, less what it hangs through.

    It stays 8 mrad short of where it goes.
    """
    t = 0.1 * np.arange(12 * len(levels))
    sent = np.repeat(np.asarray(levels, dtype=float), 12)
    side = np.sign(np.diff(sent, prepend=0.0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(t.size), 0))
    angle = gain * (sent - 0.008 * side[last]) + shift
    step = 0.0015
    angle = np.round((angle + np.random.default_rng(seed).normal(0, 2e-4, t.size)) / step) * step
    return replace(
        traced(0, "slow"), t=t, command=sent, position=angle, used=np.ones(t.size, dtype=bool)
    )


LEVELS = (0.3, 0.0, -0.3, 0.0, 0.3, 0.0)


def test_rests_are_compared_from_the_same_side():
    one, two = slow(LEVELS), slow(LEVELS, seed=1)
    moved = slow(LEVELS[::-1], shift=0.01, seed=2)
    (first, _, off), spread2 = beside_rest([one, two, moved], 2, 0.0015)
    assert np.nanmax(np.abs(first)) < 2e-3
    assert spread2 < 1e-6
    assert np.nanmean(off) == pytest.approx(0.01, abs=1e-3)
    never = slow((0.6, 0.5))
    assert np.isnan(beside_rest([one, two, never], 2, 0.0015)[0][2]).all()


@pytest.mark.parametrize(("more", "effect"), [({"shift": 0.02}, "sensor_offset"),
                                              ({"gain": 1.1}, "sensor_gain")])  # fmt: skip
def test_a_slow_recording_shows_what_changed_at_rest(more, effect):
    before = [slow(LEVELS, seed=k) for k in range(2)]
    coarse = replace(SHEET, position_step_rad=0.0015)
    assert way_of(before, [slow(LEVELS)]) == "rest"
    found = what_changed(before, [slow(LEVELS, seed=3, **more)], row(), coarse)
    assert found.groups[0].probability > 0.8
    assert effect in found.groups[0].members
    same = what_changed(before, [slow(LEVELS, seed=3)], row(), coarse)
    assert same.groups[0].probability < 0.5
    assert same.nameless < 0.5


def test_a_load_that_is_stated_wrong_is_found():
    before = Load(INERTIA)
    references = [traced(k, f"ref_{k}", seconds=8.0, load=before) for k in (1, 2)]
    moved = traced(3, "a", seconds=8.0, load=before)
    wrong = what_changed(references, [replace(moved, load=Load(1.6 * INERTIA))], row(), SHEET)
    assert "unmodelled_inertia" in wrong.named[0].members
    more = wrong.row[column("unmodelled_inertia.inertia_kgm2")]
    assert more == pytest.approx(-0.6 * INERTIA, rel=0.1)
    assert not what_changed(references, [moved], row(), SHEET).named


def test_the_law_of_the_references_is_the_motors_where_it_decides():
    references = [traced(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2)]
    case = [traced(3, "a", seconds=8.0, **RUBBING)]
    law = law_of(references, case, SHEET, np.random.default_rng(0))
    assert law.law != "pd"  # which limit its torque has makes no difference here
    of = explained(references, case, joint_row(law, None), STEP)
    assert of.way == "law"
    assert np.std(of.residual[~of.case]) < 2 * NOISE


def test_noise_may_grow_with_speed():
    rng = np.random.default_rng(0)
    speed = rng.uniform(-5, 5, 20_000)
    error = rng.normal(0, np.hypot(1e-3, 2e-3 * speed))
    error[::50] = 1.0  # wrong readings
    at_rest, moving = np.sqrt(noise_of(error, speed, 1e-9))
    assert at_rest == pytest.approx(1e-3, rel=0.2)
    assert moving == pytest.approx(2e-3, rel=0.15)  # of wrong readings, three deviations count


def changed(ratio, load=None):
    """A repeat of references with a noise of 1.5 mrad, by a servo of another gain or load."""

    def at(seed, factor, load):
        now = row(load)
        now[0] *= factor
        given = recording(1, f"take_{seed}", 8.0, 0.0, load=load)
        angle = rollout(now[None], given.t, given.command[:, 0])[0]
        noise = np.random.default_rng(seed).normal(0, NOISE, angle.size)
        return trace(replace(given, position=(angle + noise)[:, None]), "j1")

    case = replace(at(3, ratio, load or PENDULUM), load=PENDULUM)
    return [at(k, 1.0, PENDULUM) for k in (1, 2)], [case], row(PENDULUM)


PENDULUM = Load(INERTIA, pendulum_mass_kg=0.2, pendulum_length_m=0.1)


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_another_gain_is_named_with_its_ratio(ratio):
    found = what_changed(*changed(ratio), SHEET)
    assert found.groups[0].members[0] == "kp"
    assert found.groups[0].probability > 0.9
    size = found.sizes["kp"]["ratio"]
    assert size.mean == pytest.approx(ratio, rel=0.05)
    assert size.q05 < ratio < size.q95
    assert found.effects == frozenset()


def test_what_runs_differ_by_anyway_is_no_change():
    assert not what_changed(*changed(1.03), SHEET).named


def test_another_load_is_named_with_its_ratio():
    heavier = Load(1.4 * INERTIA, pendulum_mass_kg=0.28, pendulum_length_m=0.1)
    found = what_changed(*changed(1.0, heavier), SHEET)
    assert found.groups[0].members[0] == "load"
    assert found.sizes["load"]["ratio"].mean == pytest.approx(1.4, rel=0.1)
    assert found.effects == {"unmodelled_inertia", "gravity_load"}


@pytest.fixture(scope="module")
def found():
    """Diagnoses of an unchanged servo and of one with a filter, both with friction all along."""
    references = [recording(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2)]
    cases = [
        Case([recording(3, "a", seconds=8.0, **RUBBING, **more)], robot("j1"), None, references)
        for more in ({}, FILTERED)
    ]
    return [diagnose_case(case) for case in cases]


def test_references_of_another_robot_are_refused():
    case = Case([recording(1, "a")], robot("j2"), references=[recording(2, "ref")])
    with pytest.raises(InputError):
        with_known_servos(case, np.random.default_rng(0))


def test_an_unchanged_servo_gets_no_name(found):
    assert found[0].verdict == "unchanged"
    assert found[0].effects == ()
    assert found[0].model.joints["j1"].effects == ()


def test_the_change_is_named_and_modelled(found):
    (effect,) = found[1].effects
    assert {"command_filter", "sensor_filter"} & set(effect.group)
    assert effect.component == "j1"
    assert effect.probability <= DECISION.most_certain
    assert {e.effect for e in found[1].model.joints["j1"].effects} == {effect.effect}
    assert found[1].enriched_fit["j1.position_rad"]["train"] < 2 * NOISE


def test_the_first_experiment_is_a_repeat_where_there_is_none(tmp_path):
    references = [recording(k, f"ref_{k}", seconds=8.0) for k in (1, 2)]
    case = recording(3, "a", seconds=8.0)
    found = diagnose([case], robot("j1"), references=references)
    plan = found.next_experiment
    assert plan is not None
    np.testing.assert_allclose(plan.signal, steps(case.t, np.random.default_rng(3)))
    assert "Repeat the command of a" in plan.statement
    write_all(found, tmp_path / "diagnosis.json")
    commands = read_recording(tmp_path / "diagnosis.next.csv")
    np.testing.assert_allclose(commands.command[:, 0], plan.signal, atol=1e-6)
    assert np.isnan(commands.position).all()
