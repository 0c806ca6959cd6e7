import json

import pytest

from sim2real.errors import InputError
from sim2real.ranges.entry import Ranges, normal, read_ranges, uniform, write_ranges

RANGES = Ranges(
    (
        uniform("command_latency_s", 0.048, 0.088, "s", "forty swims"),
        normal("body.position_noise_m", 0.0, 0.05, "m", "forty swims", "step"),
    ),
    "posterior.npz",
    ("a note",),
    {"seed": 0},
)


@pytest.fixture
def file(tmp_path):
    write_ranges(RANGES, tmp_path / "ranges.json")
    return tmp_path / "ranges.json"


def test_the_file_is_as_the_interface_says_and_is_read(file):
    assert read_ranges(file) == RANGES
    content = json.loads(file.read_text())
    assert content["schema"] == "sim2real.ranges/1"
    assert content["ranges"][0] == {
        "parameter": "command_latency_s", "distribution": "uniform", "low": 0.048, "high": 0.088,
        "unit": "s", "period": "episode", "source": "forty swims",
    }  # fmt: skip
    assert {"mean", "sd"} < content["ranges"][1].keys()


@pytest.mark.parametrize(
    ("field", "value"),
    [("distribution", "cauchy"), ("period", "day"), ("high", 0.01), ("low", None)],
)
def test_a_spoilt_file(file, field, value):
    content = json.loads(file.read_text())
    content["ranges"][0][field] = value
    file.write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        read_ranges(file)
    assert error.value.where == f"ranges[0].{field}"


def test_two_different_ends_never_read_the_same():
    near = uniform("j1.kp_Nm_per_rad", 2.1, 2.1 * (1 + 1e-9), "N m/rad", "a fit")
    low, high = near.numbers(4).split(" to ")
    assert low != high and float(low) == pytest.approx(2.1)
    assert uniform("a", 0.0676, 0.0679, "s", "").numbers(4) == "0.0676 to 0.0679"
    assert normal("a", 0.0, 0.00199, "m", "").numbers(3) == "0 ± 0.00199"


def test_a_range_of_no_width_is_a_fixed_number():
    fixed = uniform("j1.kp_Nm_per_rad", 2.1, 2.1, "N m/rad", "the model")
    assert fixed.constant and fixed.numbers(4) == "2.1"
    assert "fixed" in str(Ranges([fixed])) and "2.1 to" not in str(Ranges([fixed]))
    assert not normal("a", 2.1, 2.1, "", "").constant
