"""Contexts of an experiment: read, refused, applied to servos."""

import pytest
from good_input import message
from rival_pair import RIVALS

from sim2real.design.contexts import AS_IT_IS, read_contexts
from sim2real.recording import Load

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


def test_loads_and_ratios_are_those_of_the_file(tmp_path):
    (arm,) = contexts(tmp_path, GOOD)
    assert arm.name == "second arm"
    assert arm.load(RIVALS) == Load(0.004, 0.05, 0.1)
    assert AS_IT_IS.load(RIVALS) == RIVALS.load
    text = '[[contexts]]\nname = "low"\nsupply_ratio = 0.5\ngain_ratio = 2.0\n'
    assert contexts(tmp_path, text)[0].ratios == {"supply_ratio": 0.5, "gain_ratio": 2.0}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "contexts"),
        ('[[contexts]]\nname = "same"\n', "a context that changes nothing"),
        ('[[contexts]]\nname = "x"\ngains = 2.0\n', "contexts[0].gains"),
        ('[[contexts]]\nname = "x"\nsupply_ratio = 0.0\n', "contexts[0].supply_ratio"),
        ('[[contexts]]\nname = "x"\ngain_ratio = 1e5\n', "a ratio from 0.001 to 1000"),
        (GOOD + GOOD, "two contexts named 'second arm'"),
        (GOOD.replace("0.004", "-1"), "contexts[0].loads.j1.inertia_kgm2"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, expected):
    message(lambda: contexts(tmp_path, text), expected)
