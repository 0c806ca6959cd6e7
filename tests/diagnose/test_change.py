"""What has changed against references: the change by its name, not what was there before."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import INERTIA, NOISE, column, recording, robot, row, steps, traced

from sim.commands.diagnose import write_all
from sim2real.diagnose.case import Case
from sim2real.diagnose.change import changed, jump_windows, what_changed
from sim2real.diagnose.contrast import Contrast, Directions, at_any_time, first_look, first_pairs
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.diagnose import diagnose, diagnose_all
from sim2real.diagnose.explained import (
    Explained,
    alignment,
    beside_rest,
    explained,
    freed_of_the_common,
    misstated,
    way_of,
)
from sim2real.diagnose.references import law_of, with_known_servos
from sim2real.errors import InputError
from sim2real.recording import Load, read_recording
from sim2real.servo.parameters import joint_row

RUBBING = {"coulomb_friction": {"torque_Nm": 0.03}}
FILTERED = {"command_filter": {"time_constant_s": 0.06}}
COUNT, KNOWN = 400, 3
NAMES = ("sensor_gain", "sensor_offset", "backlash")


def servo():
    return robot("j1").joint("j1").servo


def made(sizes, seed=0):
    """Recordings in white noise; each has the effects in these sizes, and one shared parameter."""
    rng, n = np.random.default_rng(seed), COUNT * len(sizes)
    trace = traced(0, "a")
    trace = replace(trace, t=np.arange(COUNT) / 50, used=np.ones(COUNT, dtype=bool))
    moved, shared = rng.standard_normal((len(NAMES), n)), rng.standard_normal((n, 1))
    strength = np.repeat(np.array(sizes, dtype=float), COUNT, axis=0).T
    residual = (strength * moved).sum(axis=0) + shared[:, 0] + rng.standard_normal(n)
    of = Explained(
        "law", (trace,) * len(sizes), KNOWN, residual, row(), shared, np.zeros((1, 1)), 1.0, 1.0
    )
    rows = np.tile(row(), (len(NAMES), 1))
    return of, Directions(NAMES, rows, np.array([True, True, False]), moved)


def test_a_first_look_is_least_squares():
    of, by = made([(0, 0, 0)] * KNOWN + [(0, 2, 0)])
    gone, size, left = first_look(of, by, of.case)
    table = np.column_stack([of.shared[:, 0], np.where(of.case, by.moved[1], 0.0)])
    y = of.residual
    x, rest, *_ = np.linalg.lstsq(table, y, rcond=None)
    assert left[1] == pytest.approx(np.mean((y - table @ x)[of.case] ** 2))
    without = np.linalg.lstsq(table[:, :1], y, rcond=None)[1]
    assert size[1] == pytest.approx(x[1])
    assert gone[1] == pytest.approx((without - rest)[0] / COUNT)
    assert of.loss == pytest.approx(without[0])


def test_two_at_first_sight_are_least_squares():
    of, by = made([(0, 0, 0)] * KNOWN + [(3, 2, -1)])
    ends = np.eye(3, row().size)
    pairs = first_pairs(of, replace(by, rows=ends))
    assert list(pairs) == [frozenset(NAMES[:2])]  # a negative backlash is none
    size = np.linalg.lstsq(by.moved[:2, of.case].T, of.residual[of.case], rcond=None)[0]
    np.testing.assert_allclose(pairs[frozenset(NAMES[:2])], row() + size @ (ends[:2] - row()))


def test_noise_at_any_time_takes_its_power_at_a_direction():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(2000)
    directions = np.array([np.ones(2000), np.cos(np.arange(2000) * 0.3), np.zeros(2000)])
    share = at_any_time(noise, directions)
    shifted = [
        (np.roll(noise, k) @ directions[1]) ** 2 / (directions[1] @ directions[1] * noise @ noise)
        for k in range(2000)
    ]
    assert share[1] == pytest.approx(np.mean(shifted))
    assert share[2] == 1.0
    wandering = np.convolve(noise, np.ones(100) / 100, "same")
    assert at_any_time(wandering, directions)[0] > 10 * share[0]


def test_an_effect_that_cannot_be_negative_takes_nothing_away_backwards():
    of, by = made([(0, 0, 0)] * KNOWN + [(0, 0, -2)])
    assert first_look(of, by, of.case)[0][2] == 0
    either = replace(by, signed=np.ones(3, dtype=bool))
    assert first_look(of, either, of.case)[0][2] > 3


def contrast_of(gone, null, known=4.0):
    gone, N = np.array(gone), len(gone)
    left, nothing = gone.max() - gone, np.zeros(N)
    null = np.array(null)
    known = (known, known)
    rows = np.zeros((N, 1))
    return Contrast(NAMES[:N], gone, left, nothing, rows, null, nothing, known, 1.0)


def test_what_looks_as_large_where_nothing_changed_is_no_change():
    small, large = contrast_of([4.0, 100.0], [4.0, 4.0]).evidence
    assert small < 1
    assert large > 3
    # The more unchanged recordings are known, the surer.
    assert contrast_of([100.0], [4.0], known=20.0).evidence[0] > large


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
    return [traced_of(one) for one in every]


def traced_of(given):
    from sim2real.servo.trace import trace

    return trace(given, "j1")


def test_a_repeat_shows_a_change_far_below_what_the_law_misses():
    a, b, case = repeats(offset=1e-3)
    assert way_of([a, b], [case]) == "repeat"
    found = what_changed([a, b], [case], row(), servo())
    (group,) = found.groups
    assert "sensor_offset" in group.members
    assert group.probability > 0.9
    assert found.row[column("sensor_offset.offset_rad")] == pytest.approx(1e-3, rel=0.1)
    same = what_changed([a, b], repeats()[2:], row(), servo())
    assert max(g.probability for g in same.groups) < 0.5
    assert same.nameless < 0.5


def test_a_repeat_shows_two_changes():
    a, b, case = repeats(offset=8e-3, more={"sensor_filter": {"time_constant_s": 0.02}})
    found = what_changed([a, b], [case], row(), servo())
    members = [set(group.members) for group in found.groups if group.probability > 0.5]
    assert len(members) == 2
    assert any("sensor_offset" in group for group in members)
    assert any({"sensor_filter", "command_filter"} & group for group in members)


@pytest.mark.parametrize(("halfwidth_s", "named"), [(0.0, False), (0.008, True)])
def test_a_link_that_jitters_since_shows_beside_repeats(halfwidth_s, named):
    before = [traced_of(wandering(k)) for k in range(2)]
    case = wandering(2)
    late = np.random.default_rng(5).uniform(-halfwidth_s, halfwidth_s, case.t.size)
    arrived = np.interp(case.t + late, case.t, case.command[:, 0])  # what really came
    found = what_changed(
        before, [traced_of(replace(case, command=arrived[:, None]))], row(), servo()
    )
    assert (found.link is not None) == named
    if found.link is not None:
        assert found.groups[0].members == ("latency_jitter",)
        assert found.link.value == pytest.approx(halfwidth_s, rel=0.5)


def wandering(seed):
    """A repeat of a smooth command, with fresh noise."""

    def command(t):
        return 0.5 * np.sin(2 * t) + 0.3 * np.sin(5 * t)

    return recording(seed, f"take_{seed}", 10.0, 5e-4, command=command)


def test_what_no_effect_does_has_no_name():
    a, b, case = repeats()
    strange = np.where((case.t > 4) & (case.t < 6), 0.03 * np.sin(9 * case.t), 0.0)
    found = what_changed([a, b], [replace(case, position=case.position + strange)], row(), servo())
    assert found.nameless > 0.5
    assert max(group.probability for group in found.groups) < 0.5


def test_a_horn_that_slips_is_a_jump_to_the_end():
    a, b, case = repeats()
    slip = np.where(case.t > 5, 0.05, 0.0)
    of = explained([a, b], [replace(case, position=case.position + slip)], row(), servo())
    ((window,),) = jump_windows(of)
    assert window == pytest.approx((5.0, case.t[-1]), abs=0.05)
    assert changed(of).nameless > 0.5
    assert jump_windows(explained([a, b], [case], row(), servo())) is None


def test_what_was_sent_in_a_gap_is_not_held_against_the_servo():
    a, b, case = repeats()
    keep = np.ones(case.t.size, dtype=bool)
    keep[200:230] = False
    cut = replace(
        case, t=case.t[keep], command=case.command[keep], position=case.position[keep],
        used=case.used[keep],
    )  # fmt: skip
    of = explained([a, b], [cut], row(), servo())
    soon = (cut.t > cut.t[200]) & (cut.t < cut.t[200] + 0.1)
    assert not of.traces[2].used[soon].any()
    assert changed(of).nameless < 0.5


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
    coarse = replace_step(servo(), 0.0015)
    assert way_of(before, [slow(LEVELS)]) == "rest"
    found = what_changed(before, [slow(LEVELS, seed=3, **more)], row(), coarse)
    assert found.groups[0].probability > 0.8
    assert effect in found.groups[0].members
    same = what_changed(before, [slow(LEVELS, seed=3)], row(), coarse)
    assert same.groups[0].probability < 0.5
    assert same.nameless < 0.5


def replace_step(sheet, step_rad):
    return type(sheet)(sheet.name, sheet.max_torque_Nm, sheet.no_load_speed_rad_s, step_rad)


@pytest.mark.parametrize("right", [True, False])
def test_a_load_that_is_stated_wrong_is_told_from_one_that_changed(right):
    """Both cases state twice the inertia; only one of them has it."""
    before, stated = Load(INERTIA), Load(2 * INERTIA)
    references = [traced(k, f"ref_{k}", seconds=8.0, load=before) for k in (1, 2)]
    moved = traced(3, "a", seconds=8.0, load=stated if right else before)
    of = explained(references, [replace(moved, load=stated)], row(), servo())
    effects, with_known, gain = misstated(of)
    assert effects == ("unmodelled_inertia",)
    assert gain < -50 if right else gain > 50
    assert with_known[column("unmodelled_inertia.inertia_kgm2")] == pytest.approx(-INERTIA)
    same = explained(references, [replace(moved, load=before)], row(), servo())
    assert misstated(same) is None


def test_the_law_of_the_references_is_the_motors_where_it_decides():
    references = [traced(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2)]
    case = [traced(3, "a", seconds=8.0, **RUBBING)]
    law = law_of(references, case, servo(), np.random.default_rng(0))
    assert law.law != "pd"  # which limit its torque has makes no difference here
    of = explained(references, case, joint_row(law, None), servo())
    assert of.way == "law"
    assert of.scale2 < (2 * NOISE) ** 2
    repeated = law_of(references, references[:1], servo(), np.random.default_rng(0))
    assert repeated.law == "pd"


@pytest.fixture(scope="module")
def found():
    """Diagnoses of an unchanged servo and of one with a filter, both with friction all along."""
    references = [recording(k, f"ref_{k}", seconds=8.0, **RUBBING) for k in (1, 2)]
    cases = [
        Case([recording(3, "a", seconds=8.0, **RUBBING, **more)], robot("j1"), None, references)
        for more in ({}, FILTERED)
    ]
    return diagnose_all(cases)


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
