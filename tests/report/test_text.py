"""Models as text: what is said of parameters, errors and correlations, and how wide it is."""

import math
from dataclasses import replace

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.report.quantity import Quantity, quantity_table
from sim2real.report.text import WIDTH


def row(model, joint, name):
    """The words of the line of one parameter of one joint."""
    lines = (line.split() for line in str(model).splitlines())
    return next(words for words in lines if words[:2] == [joint, name])


def one_joint(**changes):
    joint = JointModel(2.0, 0.05, 0.06, 0.002)
    return Model({"j1": replace(joint, **changes)})


def test_what_the_recordings_do_not_bound_says_so():
    infinite = {
        "kp_Nm_per_rad": (1.5, 2.5),
        "kd_Nms_per_rad": (-math.inf, math.inf),
        "latency_s": (-math.inf, 0.07),
        "motor.rotor_inertia_kgm2": (0.0, math.inf),
        "motor.coulomb_Nm": (0.0, 0.05),
    }
    motor = {"rotor_inertia_kgm2": 0.002, "coulomb_Nm": 0.01}
    model = one_joint(interval=infinite, law="motor", motor=motor)
    assert row(model, "j1", "kp")[-3:] == ["±", "25", "%"]
    assert row(model, "j1", "Coulomb")[-3:] == ["±", "250", "%"]
    assert row(model, "j1", "kd")[-2:] == ["no", "bound"]
    assert row(model, "j1", "latency")[-2] == "below" and row(model, "j1", "rotor")[-2] == "above"
    assert "inf" not in str(model) and "nan" not in str(model)


def test_says_where_the_inertia_comes_from(bench):
    assert row(bench.model, "j1", "inertia")[-1] == "stated"
    model = one_joint(per_inertia=True, inertia_kgm2=1.0)
    assert row(model, "j1", "inertia")[-4:] == ["per", "unit", "of", "inertia"]
    assert "1/s²" in row(model, "j1", "kp") and "1/s" in row(model, "j1", "kd")


def test_errors_are_in_milliradians():
    figures = {"train": 0.002, "heldout": None, "heldout_without_effects": 0.03, "whiteness": 0.02}
    text = str(replace(one_joint(), fit={"j1.position_rad": figures}))
    assert " ".join(text.splitlines()[-1].split()) == (
        "j1 2.0 mrad - - white, plain PD: 30.0 mrad held out"
    )


def test_only_strong_correlations_strongest_first():
    correlation = {"a, b": 0.29, "kp_Nm_per_rad, latency_s": -0.4, "kp_Nm_per_rad, c": 0.9}
    text = str(one_joint(correlation=correlation))
    assert "j1: correlated kp and c +0.90, kp and latency -0.40" in text
    assert "a and b" not in text


def test_effects_of_joint_and_supply_are_listed_with_intervals():
    effects = (FittedEffect("backlash", {"gap_rad": 0.03}),)
    model = one_joint(effects=effects, interval={"backlash.gap_rad": (0.027, 0.033)})
    text = str(replace(model, effects=(FittedEffect("voltage_sag", {}),)))
    assert "j1: backlash (gap_rad 0.03, 0.027 to 0.033)" in text
    assert "supply and link: voltage_sag" in text


def test_notes_are_wrapped_and_marked_and_those_of_the_model_come_last(bench):
    lines = str(replace(bench.model, notes=("j2 is heavy",))).splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("! j2: Every step"))
    assert lines[first + 1].startswith("  ") and "!" not in lines[first + 1]
    assert lines[-1] == "! j2 is heavy"


def test_no_line_is_wider_than_a_terminal_and_none_ends_in_space(bench):
    hard = {
        "x" * 300: JointModel(
            1.23456789e12,
            1.2e-7,
            0.06,
            2e-5,
            interval={"kp_Nm_per_rad": (1e-9, 1e15), "kd_Nms_per_rad": (1.1e-7, 1.3e-7)},
            correlation={f"a{k}, b{k}": 0.9 for k in range(30)},
            notes=("word " * 80,),
        )
    }
    for model in (bench.model, Model(hard), Model({})):
        for line in str(model).splitlines():
            assert len(line) <= WIDTH and line == line.rstrip()


def test_control_characters_do_not_reach_the_terminal():
    text = str(Model({"j\x1b[31m\n1": JointModel(1, 1, 0.1, 1, notes=("a\x07b",))}))
    assert "\x1b" not in text and "\x07" not in text


def test_a_table_says_the_probability_of_its_intervals():
    rows = [("j1", Quantity("kp", "N m/rad", 1.25, (1.0, 1.5)))]
    assert quantity_table(rows).header[4] == "90 % interval"
    assert quantity_table(rows, level=0.68).header[4] == "68 % interval"
