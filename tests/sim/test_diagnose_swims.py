"""Diagnosis of swims that the twin itself made: what was concealed is named, and nothing else."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from good_input import refused
from swimming_robots import FISH, LAW, servos
from test_calibrate import SENT, TIMES

import sim.inference.coordinates as places
from sim.inference import law_error, swim_problem
from sim.inference.coordinates import SERVOS, WATER_FORCES, Coordinates, candidates
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.law_error import LAW_ERROR, learned, read_law_error
from sim.inference.searched import searched
from sim.inference.signal_error import Blocks, spectrum
from sim.inference.swim_decision import decide
from sim.inference.swim_problem import COST, SwimProblem
from sim.inference.swims import block_bounds, by_followed_twin, by_twin, swim_of, with_values
from sim.twin.twin import Twin
from sim2real.body import observed, values
from sim2real.cli import main
from sim2real.recording import Recording
from sim2real.velocity import body_velocity

IN_WATER = read_law_error(law_error.IN_WATER)
OF_THIS_LAW = replace(LAW_ERROR, usual={f"twin.{name}": value for name, value in LAW.items()})
"""The error that ships, of robots whose mean law is that of the swims here."""


NAMES = ("camera_latency", "skin_elasticity", "pool_current")
"""A few candidates, so that tests take seconds."""


def only(patch, names):
    """Search these candidates alone."""
    listed = {one: free for one, free in candidates(FISH).items() if one[0] in names}
    patch.setattr(places, "candidates", lambda robot: listed)


@pytest.fixture
def few(monkeypatch):
    only(monkeypatch, NAMES)


def swum(truth, seed=0):
    """A swim of the twin itself, filmed with noise."""
    rng = np.random.default_rng(seed)
    model = with_values(servos(), truth)
    (track,) = Twin(FISH, model).swum(SENT, np.zeros(3))
    pose = observed(TIMES, track[:, :3], values(model))
    pose = pose + rng.standard_normal(pose.shape) * [0.002, 0.002, 0.008]
    joints = track[:, 3:] + 0.002 * rng.standard_normal((len(track), 3))
    columns = dict(zip(("body.x_m", "body.y_m", "body.yaw_rad"), pose.T, strict=True))
    names = tuple(joint.name for joint in FISH.joints)
    return swim_of(Recording("made", "pool", names, TIMES, SENT, joints, columns=columns), FISH)


def diagnosed(effects):
    given = [swum(effects)], servos(), FISH, by_followed_twin(FISH)
    return diagnose_swims(*given, law_error=OF_THIS_LAW)


def problem_of(swim, error=IN_WATER):
    """One swim as a problem of fits, without references."""
    simulate = by_followed_twin(FISH)
    prior = learned([], servos(), FISH, simulate, error)
    return SwimProblem(Coordinates.of(FISH, servos()), [swim], simulate, prior)


SKIN_LEFT_OUT = {"skin_elasticity.stiffness_Nm_per_rad": 0.6}


@pytest.fixture(scope="module")
def skin():
    """The diagnosis of a swim of a robot with a skin, and the fits that had not seen the end.

    Of each such fit the coordinates, and where the fit to the whole swim and this one came to lie.
    """
    seen = []
    held = SwimProblem.held

    def told(self, members, fit, share):
        found, left = held(self, members, fit, share)
        seen.append((self.coordinates, fit.x, found.x))
        return found, left

    with pytest.MonkeyPatch.context() as patch:
        only(patch, NAMES)
        patch.setattr(SwimProblem, "held", told)
        return diagnosed(SKIN_LEFT_OUT), seen


def test_what_was_concealed_is_named(skin):
    found, _ = skin
    assert found.effects[0].effect == "skin_elasticity"
    named = found.effects[0]
    assert named.probability > 0.9
    assert named.parameters["stiffness_Nm_per_rad"].mean == pytest.approx(0.6, rel=0.06)
    assert named.heldout["rmse_after"] < named.heldout["rmse_before"]
    assert "spring" in named.statement
    assert any("no reference swims" in line for line in found.gate)


def test_the_sets_that_stay_open_are_listed_with_their_parameters(skin):
    rivals = skin[0].swim_rivals
    first, *others = rivals.sets
    assert "skin_elasticity" in first.effects
    assert first.coordinates["skin_elasticity.stiffness_Nm_per_rad"] == pytest.approx(0.6, rel=0.06)
    assert sum(one.probability for one in rivals.sets) == pytest.approx(1.0)
    assert {name for one in others for name in one.effects} >= {"camera_latency", "pool_current"}
    sd = 1 / np.sqrt(np.diag(first.information))
    place = list(first.coordinates).index("skin_elasticity.stiffness_Nm_per_rad")
    assert 1e-3 < sd[place] < 0.1
    assert np.linalg.eigvalsh(first.information * np.outer(sd, sd)).min() > 0
    np.testing.assert_allclose(rivals.pose_sd, [0.002, 0.002, 0.008], rtol=0.3)


def test_errors_are_of_a_fit_that_has_not_seen_the_end(skin):
    found, fits = skin
    c, whole, first = fits[-1]
    assert not np.array_equal(whole, first), "else this test can tell nothing"
    swim = swum(SKIN_LEFT_OUT)
    (track,) = by_followed_twin(FISH)([c.model_at(first)], swim)
    pose = observed(swim.t, track[:, :3], values(c.model_at(first)))
    error = body_velocity(swim.t, pose)[:, 0] - swim.signals[:, 0]
    end = error[round(0.7 * swim.t.size) :]
    stated = found.enriched_fit["body.surge"]["heldout"]
    assert stated == pytest.approx(np.sqrt(np.mean(end**2)), rel=0.02)


def test_a_swim_with_nothing_missing_is_consistent(few):
    found = diagnosed({})
    assert found.verdict == "consistent"
    assert not [one for one in found.effects if one.probability >= 0.5]
    assert all(np.isfinite(rival.probability) for rival in found.rivals)


def test_what_another_stood_for_at_first_stands_alone_at_last(monkeypatch):
    """Where a filter was tried first for a late camera, the camera is tried without it, too."""
    only(monkeypatch, ("camera_latency", "pose_filter"))
    listed = places.candidates(FISH)
    monkeypatch.setattr(
        places, "candidates", lambda robot: dict(sorted(listed.items(), reverse=True))
    )
    monkeypatch.setattr(swim_problem, "FIRST", 1)
    hopes = SwimProblem.additions

    def filter_first(self, ledger, members, most):
        found = hopes(self, ledger, members, 2)
        return [one for one in found if members or one[0][0] == "pose_filter"]

    monkeypatch.setattr(SwimProblem, "additions", filter_first)
    found = diagnosed({"camera_latency.latency_s": 0.12})
    assert [one.effect for one in found.effects if one.probability > 0.5] == ["camera_latency"]
    assert found.effects[0].parameters["latency_s"].mean == pytest.approx(0.12, abs=0.01)


def test_a_carried_twin_swims_as_a_free_one_where_nothing_holds_it():
    """Water does not mind where a robot is: joints and speeds stay, to what sampling does."""
    swim = swum({})
    free = by_twin(FISH)([servos()], swim)[0]
    seen_at = free[:, :3] + np.array([0.3, -0.2, 0.4])
    carried = by_followed_twin(FISH, substeps=8)([servos()], replace(swim, pose=seen_at))[0]
    assert carried.shape == free.shape
    assert np.abs(carried[:, 3:] - free[:, 3:]).max() < 1e-3
    assert np.abs(carried[:, :3] - free[:, :3]).max() < 0.02


def test_coordinates_give_back_what_they_stand_for():
    c = Coordinates.of(FISH, servos())
    x = c.nominal
    assert not any(n.startswith(("tether", "skin")) for n in c.parameters(x))
    x[c.place["tether.stiffness_N_per_m"]] = 0.2
    x[c.place["tether.x_m"]] = 0.1
    x[c.place["appendage_drag.area_m2"]], x[c.place["appendage_drag.x_m"]] = 0.004, 0.0008
    x[c.place["skin_viscoelasticity.stiffness_Nm_per_rad"]] = 0.3
    x[c.place["skin_viscoelasticity.relaxation_s"]] = 0.3
    told = c.parameters(x)
    assert told["tether.x_m"] == pytest.approx(0.5)
    assert told["appendage_drag.x_m"] == pytest.approx(0.2)
    assert told["skin_viscoelasticity.stiffness_Nm_per_rad"] == pytest.approx(0.6)
    between = (places.QUICK_S * places.SLOW_S) ** 0.5
    assert told["skin_viscoelasticity.relaxation_s"] == pytest.approx(between)
    points, base = c.about(c.nominal)
    k = c.place["appendage_drag.x_m"]
    assert base[k] == c.place["appendage_drag.area_m2"] + 1
    assert c.parameters(points[k + 1])["appendage_drag.x_m"] == pytest.approx(0.1)


def test_blocks_keep_what_errors_are_worth():
    rng = np.random.default_rng(0)
    errors = rng.standard_normal((3, 500, 6))
    edges = block_bounds(500, 0.02)
    assert np.sum(spectrum(errors, edges) ** 2) == pytest.approx(np.sum(errors**2))
    blocks = Blocks.of(swum({}))
    loose = blocks.weights(2 * LAW_ERROR.shares)
    assert (loose < blocks.weights(LAW_ERROR.shares)).all()


def raw(*sets, held=None, shapes=-20.0, left=1.0):
    names = [[list(n) for n in one] for one, _ in sets]
    held = held or [(one, 900.0 - e, 0.03 - 1e-4 * e) for one, e in sets]
    return {
        "sets": [
            {"names": n, "evidence": e, "settled": True}
            for n, (_, e) in zip(names, sets, strict=True)
        ],
        "held": [{"names": [list(n) for n in one], "loss": a, "speed": b} for one, a, b in held],
        "nameless": {"best": {"wave 0.10": shapes}, "plain": {"wave 0.10": shapes}},
        "misfit": [[left] * 3] * 4,
    }


LATE, SKIN = ("camera_latency", "camera"), ("skin_elasticity", "body")
DRAG, ROUGH = ("linear_drag", "body"), ("form_drag", "body")


@pytest.mark.parametrize("file", [law_error.FILE, law_error.IN_WATER])
def test_every_decision_has_a_name_and_a_reason(file):
    content = json.loads(file.read_text())
    names = {n if n in content["reasons"] else re.split("[: ]", n)[0] for n in content["decisions"]}
    assert names == set(content["reasons"])
    assert all(content["reasons"].values())


def test_what_predicts_worse_is_not_offered():
    sets = [((), 0.0), ((LATE,), 60.0)]
    better = [((), 900.0, 0.03), ((LATE,), 800.0, 0.02)]
    worse = [((), 900.0, 0.03), ((LATE,), 950.0, 0.04)]
    said = decide(raw(*sets, held=better), LAW_ERROR.decisions)
    assert [one.name for one in said.named] == [LATE]
    assert said.verdict == "explained"
    said = decide(raw(*sets, held=worse), LAW_ERROR.decisions)
    assert not said.offered
    assert said.verdict in ("unexplained", "partly_explained")


def test_what_is_nearly_certain_need_not_change_the_speed():
    """A trim bends a path: its model predicts all signals better, and the speed hardly."""
    sets = [((), 0.0), ((LATE,), 400.0)]
    held = [((), 900.0, 0.03), ((LATE,), 800.0, 0.0299)]
    strict = LAW_ERROR.decisions | {"held_better": 0.1, "held_sure": 1.0}
    loose = strict | {"held_sure": 0.8}
    said = [decide(raw(*sets, held=held), numbers) for numbers in (strict, loose)]
    assert [one.named[0].probability > 0.8 for one in said] == [True, True]
    assert [bool(one.offered) for one in said] == [False, True]
    worse = [((), 900.0, 0.03), ((LATE,), 950.0, 0.0299)]
    assert not decide(raw(*sets, held=worse), loose).offered
    friction = (("coulomb_friction", SERVOS),)  # seen in the angles
    held = [((), 900.0, 0.03), (friction, 800.0, 0.0299)]
    assert decide(raw(((), 0.0), (friction, 400.0), held=held), strict).offered


def test_a_share_of_the_evidence_of_a_force_does_not_tell_its_kind():
    """In water a force that gains 400 joins the group of one that gains 430, but not one of 300."""
    friction, camera = ("surface_friction", "rubber"), ("camera_scale", "camera")
    sets = [[], 0.0], [[DRAG], 430.0], [[friction], 400.0], [[ROUGH], 300.0], [[camera], 395.0]
    for error, group in ((IN_WATER, {DRAG, friction, camera}), (LAW_ERROR, {DRAG})):
        (said,) = decide(raw(*sets), error.decisions).named
        assert set(said.group) == group
    alike = raw(((), 0.0), ((DRAG,), 120.0), ((ROUGH,), 119.9), ((SKIN,), 1.0))
    for settled in (True, False):  # unsettled fits are compared where there are no others
        swims = alike | {"sets": [entry | {"settled": settled} for entry in alike["sets"]]}
        said = decide(swims, LAW_ERROR.decisions)
        assert [one.group for one in said.named] == [(DRAG, ROUGH)]
        assert said.verdict == "ambiguous"


def test_a_mount_that_drifts_is_no_effect_of_the_catalogue(few):
    """Turned about the pool's middle more and more, and carried off: a shape explains it best."""
    swim, turned = swum({}), 0.015 * TIMES
    pose = swim.pose.copy()
    c, s = np.cos(turned), np.sin(turned)
    pose[:, 0] = c * swim.pose[:, 0] - s * swim.pose[:, 1] + 0.006 * TIMES
    pose[:, 1] = s * swim.pose[:, 0] + c * swim.pose[:, 1]
    pose[:, 2] += turned
    signals = np.concatenate([body_velocity(TIMES, pose), swim.signals[:, 3:]], axis=1)
    drifts = replace(swim, pose=pose, start=pose[0], signals=signals)
    found = searched(problem_of(drifts))
    shapes = found.raw["nameless"]["plain"]
    assert max(shapes, key=shapes.__getitem__) == "mount"
    gain = found.best.evidence - found.plain.evidence + COST * len(found.best.members)
    assert shapes["mount"] > gain + 10


def test_slopes_that_are_renewed_are_those_that_a_fit_moves(few):
    problem = problem_of(swum({}), LAW_ERROR)
    c = problem.coordinates
    members = frozenset(e for e in c.effects if e[0] == "pool_current")
    x = c.nominal
    known = problem.at(x)
    (effect,) = members
    x[c.effects[effect]] = 0.02
    whole, part = problem.at(x), problem.at(x, members, known)
    own = c.in_fit(members)
    np.testing.assert_allclose(part.slope[:, own], whole.slope[:, own], atol=1e-9)
    np.testing.assert_array_equal(part.slope[:, ~own], known.slope[:, ~own])


def test_what_is_there_is_not_passed_off_as_error(few):
    """A strong skin, left out, seems to be there by no more than error may seem to be."""
    problem = problem_of(swum(SKIN_LEFT_OUT))
    plain = problem.plain()
    step = np.abs(problem.seems(plain.members, plain.fit))
    absent = ~problem.coordinates.in_fit(plain.members)
    usual = np.sqrt(np.diag(problem.prior.covariance))[absent]
    assert (step[absent] <= 3.001 * usual).all()
    assert (step[absent] > 2.999 * usual).any()


def test_a_skin_that_would_have_to_push_is_no_evidence():
    """At the bound of what may be, what lies beyond it speaks for nothing; so of resistances."""
    swim = swum({"j1.kp_Nm_per_rad": 1.3 * servos().joints["j1"].kp_Nm_per_rad})
    problem = problem_of(swim)
    c = problem.coordinates
    assert all(
        column.low == 0.0
        for column in c.columns
        if column.effect and column.effect[0] in WATER_FORCES
    )
    plain = problem.plain()
    for effect in c.effects:
        if effect[0] in ("skin_elasticity", "linear_drag"):
            members = frozenset({effect})
            step = problem.seems(members, plain.fit)[c.effects[effect]]
            assert (step >= 0.0).all()


def test_swims_that_agree_tell_a_robot_that_is_steady():
    """Two swims with the same error are nearer to their robot than two that err apart."""
    simulate, usual = by_followed_twin(FISH), replace(IN_WATER, shift={})
    c = Coordinates.of(FISH, servos())
    speed = c.place["error.surge_0"]

    def scale(share):
        swims = [swum({}, seed=3), swum({}, seed=4)]
        for k, sign in enumerate((1, -1)):
            signals = swims[k].signals * [1 + sign * share, 1, 1, 1, 1, 1]
            swims[k] = replace(swims[k], signals=signals)
        known = learned(swims, servos(), FISH, simulate, usual)
        return known.imitation[speed] / usual.prior(c).imitation[speed]

    assert scale(0.0) < 0.9 < 1.1 < scale(0.1)


def test_a_shape_without_a_name_makes_it_abstain():
    sets = [((), 0.0), ((LATE,), 60.0)]
    said = decide(raw(*sets, shapes=500.0, left=30.0), LAW_ERROR.decisions)
    assert said.verdict == "unexplained"
    assert all(one.probability < 0.5 for one in said.named)
    assert all(probability < 0.5 for _, probability in said.rivals)


def test_swims_need_a_model_and_no_bench_beside_them(tmp_path, capsys):
    robot = ["--robot", "datasets/pool/robot.toml", "--out", str(tmp_path / "d.json")]
    status = main(["diagnose", "datasets/pool/p1.csv", *robot])
    refused(capsys, status, "the model of the servos")
    both = ["datasets/pool/p1.csv", "datasets/servo_steps/steps.csv"]
    status = main(["diagnose", *both, *robot, "--model", "datasets/pool/model.json"])
    refused(capsys, status, "swims alone")
    assert not (tmp_path / "d.json").exists()


def test_the_command_writes_what_the_format_says(few, short, tmp_path, monkeypatch):
    monkeypatch.chdir(short)
    out = tmp_path / "d.json"
    given = ["datasets/pool/p1.csv", "--robot", "datasets/pool/robot.toml"]
    assert main(["diagnose", *given, "--model", "datasets/pool/model.json", "--out", str(out)]) == 0
    content = json.loads(out.read_text())
    assert content["schema"] == "sim2real.diagnosis/1"
    assert content["verdict"] in ("explained", "partly_explained", "unexplained")
    assert content["unknown"]["body"] >= 0
    assert (tmp_path / content["model"]).exists()
    assert content["provenance"]["seed"] is None  # nothing is drawn at random
    page = out.with_suffix(".html")
    assert "Diagnosis" in page.read_text()
    page.unlink()
    designed = tmp_path / "designed.csv"
    designed.write_text((short / "datasets" / "pool" / "p1.csv").read_text())
    sidecar = json.loads((short / "datasets" / "pool" / "p1.json").read_text())
    pair = {"first": ["skin_elasticity"], "second": ["camera_latency"], "expected": 0.95}
    sidecar["rivals"] = [{"component": "body", "pairs": [pair]}]
    designed.with_suffix(".json").write_text(json.dumps(sidecar))
    assert main(["diagnose", str(designed), *given[1:], "--model", "datasets/pool/model.json",
                 "--out", str(out), "--no-page"]) == 0  # fmt: skip
    assert not page.exists()
    again = json.loads(out.read_text())
    assert again["effects"] == content["effects"]
    (told,) = again["separations"]
    assert told["favoured"] == ["skin_elasticity"]
    assert told["found"] > 0.9
    assert told["expected"] == 0.95
