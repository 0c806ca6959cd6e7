import math
from dataclasses import replace

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.report.table import WIDTH, fit_report


def row(table, joint, name):
    """The cells' line of one parameter of one joint."""
    lines = table.splitlines()
    below = lines[lines.index(joint) + 1 :]
    return next(line for line in below if line.split()[:1] == [name])


def one_joint(**changes):
    joint = JointModel(2.0, 0.05, 0.06, 0.002)
    return Model({"j1": replace(joint, **changes)})


def test_a_parameter_has_value_interval_percent_and_unit(bench):
    line = row(fit_report(bench.model), "j1", "kp")
    assert line.split() == ["kp", "2.204", "N", "m/rad", "2.110", "to", "2.298", "±", "4.3", "%"]


def test_latency_is_in_milliseconds(bench):
    line = row(fit_report(bench.model), "j1", "latency")
    assert "66.0" in line and " ms " in line and "64.3 to 67.7" in line


def test_parameters_with_an_infinite_end_share_one_line():
    infinite = {
        "kp_Nm_per_rad": (1.5, 2.5),
        "kd_Nms_per_rad": (-math.inf, math.inf),
        "latency_s": (-math.inf, 0.07),
        "motor.rotor_inertia_kgm2": (0.0, math.inf),
        "motor.coulomb_Nm": (0.0, 0.05),
    }
    motor = {"rotor_inertia_kgm2": 0.002, "coulomb_Nm": 0.01}
    table = fit_report(one_joint(interval=infinite, law="motor", motor=motor))
    named = [line for line in table.splitlines() if "not determined" in line]
    assert named == ["  not determined: kd, latency, rotor inertia"]
    assert row(table, "j1", "kp").endswith("± 25 %")
    assert row(table, "j1", "Coulomb").endswith("± 250 %")
    assert table.count("kd") == table.count("latency") == table.count("rotor inertia") == 1
    assert "inf" not in table and "nan" not in table


def test_a_joint_whose_parameters_are_all_determined_has_no_such_line():
    ends = {"kp_Nm_per_rad": (1.5, 2.5), "kd_Nms_per_rad": (0.04, 0.06)}
    assert "not determined" not in fit_report(one_joint(interval=ends))


def test_many_undetermined_parameters_are_wrapped():
    motor = {f"a_parameter_with_a_long_name_{k}": 1.0 for k in range(12)}
    ends = {f"motor.{name}": (0.0, math.inf) for name in motor}
    table = fit_report(one_joint(interval=ends, law="motor", motor=motor))
    text = " ".join(table.split())
    assert all(f"a parameter with a long name {k}," in text for k in range(11))
    assert all(len(line) <= WIDTH for line in table.splitlines())


def test_says_where_the_inertia_comes_from(bench):
    assert row(fit_report(bench.model), "j1", "inertia").endswith("stated")
    table = fit_report(one_joint(per_inertia=True, inertia_kgm2=1.0))
    assert row(table, "j1", "inertia").endswith("per unit of inertia")
    assert " 1/s² " in row(table, "j1", "kp") and " 1/s " in row(table, "j1", "kd")


def test_errors_are_in_milliradians(bench):
    assert "4.1 mrad train, 4.3 mrad held out; noise 1.9 mrad" in fit_report(bench.model)


def test_missing_figures_are_a_dash():
    model = replace(one_joint(), fit={"j1.position_rad": {"train": 0.004, "heldout": None}})
    assert "4.0 mrad train, - held out" in fit_report(model)


def test_only_strong_correlations_strongest_first():
    correlation = {"a, b": 0.29, "kp_Nm_per_rad, latency_s": -0.4, "kp_Nm_per_rad, c": 0.9}
    table = fit_report(one_joint(correlation=correlation))
    assert "kp and c +0.90, kp and latency -0.40" in table
    assert "a and b" not in table


def test_effects_of_joint_and_supply_are_listed():
    model = one_joint(effects=(FittedEffect("backlash", {"gap_rad": 0.03}),))
    table = fit_report(replace(model, effects=(FittedEffect("voltage_sag", {}),)))
    assert "backlash (gap_rad 0.03)" in table and "voltage_sag" in table


def test_notes_are_wrapped_and_marked(bench):
    lines = fit_report(bench.model).splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("  ! Every step"))
    assert lines[first + 1].startswith("    ") and "!" not in lines[first + 1]


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
        for line in fit_report(model).splitlines():
            assert len(line) <= WIDTH and line == line.rstrip()


def test_control_characters_do_not_reach_the_terminal():
    model = Model({"j\x1b[31m\n1": JointModel(1, 1, 0.1, 1, notes=("a\x07b",))})
    table = fit_report(model)
    assert "\x1b" not in table and "\x07" not in table


def test_notes_on_the_whole_model_come_last():
    model = replace(one_joint(), notes=("j2 does not move",))
    assert fit_report(model).splitlines()[-1] == "  ! j2 does not move"


def test_effects_show_their_intervals_and_what_they_are_worth():
    effects = (FittedEffect("backlash", {"gap_rad": 0.03}),)
    joint = replace(one_joint().joints["j1"], effects=effects,
                    interval={"backlash.gap_rad": (0.027, 0.033)})  # fmt: skip
    figures = {"train": 0.002, "heldout": 0.003, "train_without_effects": 0.02,
               "heldout_without_effects": 0.03}  # fmt: skip
    table = fit_report(Model({"j1": joint}, fit={"j1.position_rad": figures}))
    assert "backlash (gap_rad 0.03, 0.027 to 0.033)" in table
    assert "plain PD    20.0 mrad train, 30.0 mrad held out" in table
