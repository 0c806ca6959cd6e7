"""Contexts of an experiment: read, refused, applied to servos."""

import numpy as np
import pytest
from good_input import message
from rival_pair import RIVALS

from sim2real.design.contexts import AS_IT_IS, read_contexts
from sim2real.recording import Load
from sim2real.servo.parameters import COLUMNS

GOOD = """
[[contexts]]
name = "second arm"
[contexts.loads.j1]
inertia_kgm2 = 0.004
pendulum_mass_kg = 0.05
pendulum_length_m = 0.1
"""


def contexts(folder, text):
    path = folder / "contexts.toml"
    path.write_text(text)
    return read_contexts(path)


def test_loads_are_those_of_the_file(tmp_path):
    (arm,) = contexts(tmp_path, GOOD)
    assert arm.name == "second arm"
    assert arm.load(RIVALS) == Load(0.004, 0.05, 0.1)
    assert AS_IT_IS.load(RIVALS) == RIVALS.load


def test_supply_scales_what_the_voltage_gives_and_gain_the_gain(tmp_path):
    text = '[[contexts]]\nname = "{}"\n{} = 0.5\n'
    (low,) = contexts(tmp_path, text.format("low", "supply_ratio"))
    (soft,) = contexts(tmp_path, text.format("soft", "gain_ratio"))
    row = np.zeros((1, len(COLUMNS)))
    names = ["kp_Nm_per_rad", "kd_Nms_per_rad", "motor.stall_torque_Nm"]
    row[0, [COLUMNS.index(name) for name in names]] = 2.0, 0.1, 3.0
    for context, expected in ((low, (1.0, 0.1, 1.5)), (soft, (1.0, 0.1, 3.0))):
        changed = context.applied(row)[0, [COLUMNS.index(name) for name in names]]
        np.testing.assert_allclose(changed, expected)
    assert row[0, 0] == 2.0, "the row that is given stays as it is"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "contexts"),
        ('[[contexts]]\nname = "same"\n', "a context that changes nothing"),
        ('[[contexts]]\nname = "x"\ngains = 2.0\n', "contexts[0].gains"),
        ('[[contexts]]\nname = "x"\nsupply_ratio = 0.0\n', "contexts[0].supply_ratio"),
        (GOOD + GOOD, "two contexts named 'second arm'"),
        (GOOD.replace("0.004", "-1"), "contexts[0].loads.j1.inertia_kgm2"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, expected):
    message(lambda: contexts(tmp_path, text), expected)
