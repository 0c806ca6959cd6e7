import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim2real.diagnose.result import (
    DetectionLimit,
    Diagnosis,
    Estimate,
    Experiment,
    JointSeries,
    Mismatch,
    NamedEffect,
    Rival,
    write_diagnosis,
)
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.diagnosis_plots import plain
from sim2real.report.page import Figure, Note, Table, Text, render_page

NOISE = 0.0015


def joint(*effects):
    load = Load(0.002)
    return JointModel(1.76, 0.05, 0.066, 0.002, load=load, effects=effects)


def evidence(recording, *, samples=1500, helps=True, seed=0):
    """A joint that follows chirp-like commands and misses them just after reversals."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(samples)
    command = 0.6 * np.sin(2.1 * t) * np.sin(0.33 * t + seed)
    speed = np.gradient(command, t)
    lacking = -0.03 * np.tanh(20 * speed)
    true = command + 0.15 * lacking
    position = true + rng.normal(0, NOISE, t.size)
    position[200:212] = np.nan
    torque = lacking + rng.normal(0, 0.004, t.size)
    enriched = true if helps else command
    spread = np.full(t.size, 0.004)
    return JointSeries(
        "j2", recording, t, command, position, command, enriched, speed, torque, spread,
        lacking if helps else np.zeros(t.size),
    )  # fmt: skip


MISMATCH = Mismatch(
    signal="j2.position_rad",
    component="j2",
    rmse=0.0047,
    noise=NOISE,
    share=0.90,
    windows_s={"steps": ((2.0, 4.5), (11.0, 12.5)), "chirp": ()},
    where="it depends on the speed and its sign: just after reversals above all",
    dependence={"speed": 0.61, "position": 0.22, "error": 0.18, "time": 0.01},
)
NAMED = NamedEffect(
    effect="coulomb_friction",
    component="j2",
    probability=0.982,
    group=("coulomb_friction",),
    parameters={"torque_Nm": Estimate(0.0312, 0.0012, 0.0292, 0.0332)},
    heldout={"rmse_before": 0.0047, "rmse_after": 0.0017, "recoverable_removed": 0.94},
    baseline_shift={"kp_Nm_per_rad": -0.24, "kd_Nms_per_rad": 0.0001, "latency_s": 0.008},
    statement="j2: dry friction of 0.0312 N m holds the shaft.",
)


def fits(**heldout):
    """Errors of joints."""
    return {f"{j}.position_rad": {"heldout": x, "noise": NOISE} for j, x in heldout.items()}


CONSISTENT = Diagnosis(
    verdict="consistent",
    mismatch=(),
    effects=(),
    rivals=(),
    unknown={"j1": 0.0, "j2": 0.0, "j3": 0.0},
    baseline_fit={},
    enriched_fit={},
    detection_limits=(),
    next_experiment=None,
    gate=(),
    model=Model({"j1": joint(), "j2": joint(), "j3": joint()}),
)
EXPLAINED = replace(
    CONSISTENT,
    verdict="explained",
    mismatch=(MISMATCH,),
    effects=(NAMED,),
    rivals=(Rival("stribeck_friction", "j2", 0.012), Rival("backlash", "j2", 0.003)),
    unknown={"j1": 0.0, "j2": 0.02, "j3": 0.0},
    baseline_fit=fits(j1=0.0016, j2=0.0047),
    enriched_fit=fits(j1=0.0016, j2=0.0017),
    detection_limits=tuple(
        DetectionLimit(effect, name, {parameter: value})
        for name in ("j1", "j2", "j3")
        for effect, parameter, value in (
            ("coulomb_friction", "torque_Nm", 0.0021),
            ("backlash", "gap_rad", 0.0034),
            ("thermal_derating", "loss", None if name == "j1" else 0.08),
        )
    ),
    gate=("steps: 12 samples of j2 are missing from 4.0 s to 4.2 s.",),
    model=Model({"j1": joint(), "j2": joint(FittedEffect("coulomb_friction", {})), "j3": joint()}),
    evidence=(evidence("steps"), evidence("chirp", samples=9000, seed=1)),
)
AMBIGUOUS = replace(
    EXPLAINED,
    verdict="ambiguous",
    effects=(
        replace(
            NAMED,
            effect="backlash",
            probability=0.998,
            group=("backlash", "deadband"),
            parameters={"gap_rad": Estimate(0.03, 0.001, 0.028, 0.032)},
            statement="j2: the gears have 1.72° of play.",
        ),
    ),
    next_experiment=Experiment(
        component="j2",
        separates=("backlash", "deadband"),
        command="slow triangles of three amplitudes",
        context="none",
        separation=14.2,
        duration_s=20.0,
        statement="Record j2 under slow triangles: play shows at reversals, a dead band at rest.",
        file="diagnosis.j2.csv",
        t=0.02 * np.arange(1000),
        signal=0.3 * np.abs(np.mod(0.01 * np.arange(1000), 2) - 1),
    ),
)
UNEXPLAINED = replace(
    EXPLAINED,
    verdict="unexplained",
    effects=(),
    unknown={"j1": 0.0, "j2": 0.93, "j3": 0.0},
    evidence=(evidence("steps", helps=False),),
)


@cache
def explained():
    """What is said of ``EXPLAINED``, whose figures take a second to draw."""
    return said(EXPLAINED)


def said(diagnosis):
    """Everything that the section says, as one text; and its blocks."""
    section = diagnosis_section(diagnosis)
    words = []
    for block in section.blocks:
        if isinstance(block, Text):
            words += [block.heading, block.paragraph]
        elif isinstance(block, Note):
            words.append(block.text)
        elif isinstance(block, Table):
            words += [*block.header, *(cell for row in block.rows for cell in row), block.caption]
        else:
            words += [block.caption, *re.findall(r"<text[^>]*>([^<]*)", block.svg)]
    return " ".join(words).replace("\u00a0", " "), section.blocks


def test_consistent_says_so_and_nothing_more():
    text, blocks = said(CONSISTENT)
    assert blocks[0].kind == "good" and "no mismatch that matters" in text
    assert not any(isinstance(block, Figure | Table) for block in blocks)


def test_named_effect_is_told_with_its_probability_and_size():
    text, blocks = explained()
    assert "dry friction of 0.0312 N m holds the shaft. 98 % sure." in text
    assert "0.0312 N m" in text and "0.0292 N m – 0.0332 N m" in text
    assert "cannot tell" not in " ".join(b.text for b in blocks if isinstance(b, Note))
    assert "after reversals above all" in text
    assert "12 samples of j2 are missing" in text
    assert "Guess" not in text and "guess" not in text


def test_a_search_that_its_budget_ended_is_told_on_page_terminal_and_in_the_file(tmp_path):
    ended = replace(EXPLAINED, unfinished=("j2",))
    text, _ = said(ended)
    sentence = "The search for combinations of effects on j2 was ended by its simulation budget"
    assert sentence in text and sentence in str(ended)
    assert "budget" not in explained()[0] and "budget" not in str(EXPLAINED)
    for one in (ended, EXPLAINED):
        write_diagnosis(one, tmp_path / "d.json", "m.json")
        search = json.loads((tmp_path / "d.json").read_text())["search"]
        assert search["complete"] == (one is EXPLAINED)
        assert search["unfinished"] == list(one.unfinished)


def table(blocks, first):
    (found,) = [b for b in blocks if isinstance(b, Table) and b.header[0] == first]
    return found


def test_what_the_plain_fit_had_been_hiding():
    _, blocks = explained()
    shifts = table(blocks, "servo")
    assert "Bias of the plain fit" in shifts.caption
    (row,) = shifts.rows
    assert row[:2] == ("j2", "−12 %\n2 to 1.76 N m/rad")
    assert row[2].startswith("0 %\n") and row[3] == "+14 %\n58 to 66 ms"


def test_joints_without_mismatch_get_one_sentence():
    text, blocks = explained()
    errors = "j1 has an error of 1.6 mrad, with 1.5 mrad of noise"
    assert f"j1 and j3 follow the plain servo down to the noise: {errors}." in text
    assert [b.heading for b in blocks if isinstance(b, Text) and b.heading.startswith("Where")] == [
        "Where j2 differs"
    ]


def test_an_error_far_above_the_noise_is_no_good_news():
    found = replace(CONSISTENT, baseline_fit=fits(j1=0.0112))
    sentence = "j1: RMSE 11.2 mrad, 7 times the noise of 1.5 mrad, although no effect explains it"
    text, blocks = said(found)
    assert sentence in text
    assert "j2 and j3 follow the plain servo down to the noise" in text
    assert any(isinstance(b, Note) and b.kind == "warn" and sentence in b.text for b in blocks)
    assert sentence in str(found)


def test_detection_limits_are_one_row_an_effect():
    _, blocks = explained()
    (table,) = [b for b in blocks if isinstance(b, Table) and "j1" in b.header]
    assert table.header == ("effect", "j1", "j2", "j3")
    assert table.rows[0] == ("Coulomb friction", *["2.1 mN m"] * 3)
    assert table.rows[2] == ("thermal derating of the motor", "–", "8 %", "8 %")


def test_members_of_a_group_are_named_with_the_next_experiment():
    text, _ = said(AMBIGUOUS)
    assert "More than 99 % sure that it is one of them." in text
    both = "cannot tell backlash from a dead band of the controller"
    assert f"These recordings {both}." in text
    assert "j2: one of backlash or a dead band of the controller" in text
    assert "Record j2 under slow triangles" in text
    told = replace(AMBIGUOUS.effects[0], statement=f"j2: play (or x: these recordings {both}).")
    assert said(replace(AMBIGUOUS, effects=(told,)))[0].count("cannot tell backlash") == 1


def test_what_is_unexplained_says_so_and_how_surely():
    text, blocks = said(UNEXPLAINED)
    assert "The probability of that is 93 %." in text
    assert "Coloured" not in text
    assert blocks[0].kind == "warn" and "no effect in the catalogue explains" in text
    assert "enriched" not in text and [row[2] for row in table(blocks, "error of").rows] == ["–"]
    assert "model chosen for prediction changes the error of j2" in text
    assert "named effects change the error of j2" in explained()[0]
    located = replace(UNEXPLAINED, mismatch=(replace(MISMATCH, remainder="70 % is at rest."),))
    assert "70 % is at rest." in said(located)[0].replace("\u00a0", " ")
    assert "70 % is at rest." in str(located)


def test_torque_without_a_known_load_is_per_inertia():
    bare = replace(EXPLAINED.model.joints["j2"], per_inertia=True)
    text, _ = said(replace(EXPLAINED, model=Model({"j2": bare})))
    assert "0.0312 N m/(kg m²)" in text and "missing torque, N m/(kg m²)" in text


@pytest.mark.parametrize("whole", [EXPLAINED, AMBIGUOUS, UNEXPLAINED])
def test_empty_parts_do_no_harm(whole):
    nothing = {"parameters": {}, "heldout": {}, "baseline_shift": {}}
    empty = replace(
        whole,
        mismatch=(replace(MISMATCH, windows_s={}, where="", dependence={}),),
        effects=tuple(replace(effect, **nothing) for effect in whole.effects),
        rivals=(),
        unknown={},
        baseline_fit=fits(j2=0.004),
        enriched_fit=fits(j2=0.004),
        next_experiment=whole.next_experiment and replace(whole.next_experiment, t=None),
        model=Model({}),
    )
    unmeasured = replace(EXPLAINED.evidence[0], position=np.full(1500, np.nan))
    still = np.full(1500, 0.1)
    none = dict.fromkeys(("speed", "torque", "torque_sd"), 0 * still)
    resting = replace(EXPLAINED.evidence[0], position=still, **none)
    for some in ((), (unmeasured,), (resting,)):
        render_page("a", "", [diagnosis_section(replace(empty, evidence=some))], {})
    diagnosis_section(replace(empty, mismatch=(), effects=()))


def test_effects_have_plain_names():
    beyond = ("skin_elasticity", "pool_current", "com_offset", "pose_filter", "dropped_frames")
    for effect in ("deadband", "voltage_sag", "sensor_gain", *beyond):
        assert plain(effect) != effect.replace("_", " ")
    assert plain("deadband") == "a dead band of the controller"


def test_what_the_written_model_holds_besides_the_names_is_no_claim():
    servo = joint(FittedEffect("backlash", {"gap_rad": 0.02}))
    model = replace(EXPLAINED.model, joints={**EXPLAINED.model.joints, "j2": servo})
    text, _ = said(replace(EXPLAINED, model=model))
    assert "selected for prediction and also contains backlash" in text
    assert "imply that they are present" in text
