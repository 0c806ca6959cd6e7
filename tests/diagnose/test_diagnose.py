"""From recordings to a diagnosis: dry friction by its name, nothing where nothing is missing."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from simulated import FRICTION, KD, KP, LATENCY, NOISE, beside, recording, robot, two
from strange import position_damping, strange

from sim2real.diagnose.calibrated_odds import judged
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.diagnose import Case, diagnose, diagnose_case
from sim2real.diagnose.joint_result import includes_zero
from sim2real.diagnose.result import percent, write_diagnosis
from sim2real.diagnose.wording import diagnosis
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.model import read_model, write_model
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.page import Note
from sim2real.servo.prediction import predict


@pytest.fixture(scope="module")
def clean():
    return diagnose(two(), robot("j1"))


@pytest.fixture(scope="module")
def written(explained, tmp_path_factory):
    folder = tmp_path_factory.mktemp("diagnosis")
    write_model(explained.model, folder / "enriched.json")
    write_diagnosis(explained, folder / "diagnosis.json", "enriched.json")
    return folder, json.loads((folder / "diagnosis.json").read_text())


def test_nothing_missing_is_consistent(clean):
    assert clean.verdict == "consistent"
    assert clean.mismatch == ()
    assert clean.effects == ()
    assert clean.next_experiment is None
    servo = clean.model.joints["j1"]
    assert servo.effects == ()
    found = (servo.kp_Nm_per_rad, servo.kd_Nms_per_rad, servo.latency_s)
    np.testing.assert_allclose(found, (KP, KD, LATENCY), rtol=0.02)


def test_dry_friction_is_named_with_its_size(explained):
    assert explained.verdict == "explained"
    (effect,) = explained.effects
    assert (effect.effect, effect.component) == ("coulomb_friction", "j1")
    assert effect.group == ("coulomb_friction",)
    assert effect.probability > 0.85
    assert "j1" in effect.statement and "friction" in effect.statement
    estimate = effect.parameters["torque_Nm"]
    assert abs(estimate.mean - 0.05) < 4 * estimate.sd
    assert estimate.q05 < estimate.mean < estimate.q95
    assert estimate.sd < 0.002
    heldout = effect.heldout
    assert heldout["rmse_after"] == pytest.approx(NOISE, rel=0.08)
    assert heldout["rmse_before"] > 3 * heldout["rmse_after"]
    assert heldout["recoverable_removed"] > 0.9


def test_what_the_plain_fit_had_hidden_is_said(explained):
    """Friction passes for damping and weakness until it has a name."""
    shift = explained.effects[0].baseline_shift
    rich, plain = explained.model.joints["j1"], explained.baseline.joints["j1"]
    assert set(shift) == {"kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"}
    assert shift["kd_Nms_per_rad"] < 0
    assert rich.kd_Nms_per_rad == pytest.approx(KD, rel=0.02)
    assert abs(plain.kd_Nms_per_rad - KD) > abs(rich.kd_Nms_per_rad - KD)


def test_mismatch_says_where(explained):
    (entry,) = explained.mismatch
    assert (entry.signal, entry.component) == ("j1.position_rad", "j1")
    assert entry.noise == pytest.approx(NOISE, rel=0.3)
    assert entry.rmse > 3 * entry.noise
    assert 0.5 < entry.share <= 1
    assert set(entry.windows_s) == {"a", "b"}
    assert any(entry.windows_s.values())
    assert "speed" in entry.where
    assert max(entry.dependence, key=entry.dependence.get) == "speed"


def test_the_file_has_every_field_of_the_format(written):
    _, file = written
    assert file["schema"] == "sim2real.diagnosis/1"
    assert file["next_experiment"] is None
    assert {"verdict", "model"} <= set(file)
    (mismatch,), (effect,) = file["mismatch"], file["effects"]
    assert all(begin < end for begin, end in mismatch["windows_s"])
    assert effect["statement"]
    for found, names in (
        ([mismatch], "signal component rmse noise share windows_s where"),
        (
            [effect],
            "effect component probability group parameters heldout baseline_shift statement",
        ),
        ([effect["parameters"]["torque_Nm"]], "mean sd q05 q95"),
        ([effect["heldout"]], "rmse_before rmse_after recoverable_removed"),
        (file["rivals"], "effect component probability"),
        ([fit["j1.position_rad"] for fit in file["fit"].values()], "train heldout"),
        (file["detection_limits"], "effect component smallest"),
    ):
        assert found and all(set(names.split()) <= set(one) for one in found), names


def test_page_file_and_terminal_state_one_probability(explained, written):
    (effect,) = explained.effects
    (on_file,) = written[1]["effects"]
    assert on_file["probability"] == effect.probability
    stated = percent(effect.probability)
    (line,) = [x for x in str(explained).splitlines() if effect.statement in x]
    assert line.split("  ")[1].strip() == stated
    blocks = diagnosis_section(explained).blocks
    (note,) = [b for b in blocks if isinstance(b, Note) and effect.statement in b.text]
    assert re.findall(r"(\d+)\s%", note.text) == [stated.removesuffix(" %")]


def test_effects_that_leave_structure_explain_a_part(explained_joint):
    """Up to what 99 % of joints that miss nothing leave, an effect explains; beyond it a part."""
    case, (joint,) = explained_joint

    def verdict(**changed):
        return diagnosis(case, [replace(joint, **changed)], DECISION.negligible, 0).verdict

    for excess, expected in ((1.0, "explained"), (1.3, "explained"), (1.5, "partly_explained")):
        assert verdict(finding=replace(joint.finding, excess=excess)) == expected
    finer = replace(joint.joint, noise=joint.joint.noise / 4)
    assert verdict(joint=finer) == "partly_explained", "four noises stay on held-out data"


def test_an_effect_that_may_be_zero_is_not_named(explained_joint):
    """The same finding with errors a thousand times as large, which makes the interval as wide."""
    _, (joint,) = explained_joint
    tried, best = joint.finding.tried, joint.finding.best
    assert not includes_zero(tried, best, "coulomb_friction")
    assert [g.members for g in judged(joint.finding, joint.unseen).groups] == [
        ("coulomb_friction",)
    ]
    gram = np.array(best.fit.gram)
    gram[:, :, 0, 0] *= 1e6
    vague = replace(best, fit=replace(best.fit, gram=gram))
    assert includes_zero(tried, vague, "coulomb_friction")
    assert judged(replace(joint.finding, best=vague), joint.unseen).groups == ()


def test_what_is_in_no_catalogue_is_unexplained():
    given = [strange(k, name, position_damping, seconds=6.0) for k, name in ((1, "a"), (2, "b"))]
    found = diagnose_case(Case(given, robot("j1")))
    assert found.verdict == "unexplained"
    assert not found.effects, "nothing that matters has a name"


def test_the_enriched_model_can_be_read_and_predicts(written):
    folder, file = written
    model = read_model(folder / file["model"])
    unseen = recording(7, "unseen", noise=0.0, **FRICTION)
    sent = {"j1": unseen.command[:, 0]}
    angle = predict(model, unseen.t, sent, unseen.loads)["j1"]
    assert np.sqrt(np.mean((angle - unseen.position[:, 0]) ** 2)) < NOISE / 3


def test_a_model_that_has_the_effect_misses_nothing(explained):
    found = diagnose(two(**FRICTION), robot("j1"), model=explained.model)
    assert found.verdict == "consistent"
    assert [e.effect for e in found.model.joints["j1"].effects] == ["coulomb_friction"]


def test_what_hardly_changes_the_error_is_listed_and_makes_no_verdict(explained):
    """Asked to neglect what takes away less than nearly all of the error, friction is neglected."""
    assert explained.negligible == ()
    found = diagnose_case(Case(two(**FRICTION), robot("j1")), negligible=0.999)
    assert found.verdict == "consistent"
    assert found.effects == ()
    assert [e.effect for e in found.negligible] == [e.effect for e in explained.effects]


def test_only_the_joint_that_has_it_is_named():
    recordings = [
        beside(recording(k, name, seconds=5.0), recording(k + 5, name, seconds=5.0, **FRICTION))
        for k, name in ((1, "a"), (2, "b"))
    ]
    found = diagnose_case(Case(recordings, robot("j1", "j2")))
    assert [(e.effect, e.component) for e in found.effects] == [("coulomb_friction", "j2")]
    assert [m.component for m in found.mismatch] == ["j2"]


def test_no_motion_is_refused():
    still = recording(1, "still", command=np.zeros_like)
    flat = replace(still, position=np.zeros_like(still.position))
    with pytest.raises(InputError, match=r"still.csv.*no motion"):
        diagnose([flat], robot("j1"))


@pytest.mark.parametrize("effects", [{}, FRICTION], ids=["plain", "rubbing"])
def test_the_baseline_is_what_identify_finds(effects):
    """One estimator: the same recordings and the same model have one pair of gains."""
    shown, other = two(**effects)
    found = diagnose_case(Case([shown], robot("j1")))
    known = identify([shown, other], robot("j1"), held_out="b", law="pd", refit=False).joints["j1"]
    assert bool(found.mismatch) == bool(effects)
    baseline = found.baseline.joints["j1"]
    for name in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"):
        width = np.diff(known.interval[name])[0]
        assert getattr(baseline, name) == pytest.approx(getattr(known, name), abs=2e-3 * width)


def test_a_joint_may_stand_still_in_one_recording():
    first, alone = two()
    both = beside(first, recording(3, "a", seconds=8.0))
    assert diagnose([both, alone], robot("j1", "j2")).verdict == "consistent"
