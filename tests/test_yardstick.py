"""The yardstick reports what moved between two answers, and nothing else."""

from copy import deepcopy

import pytest

from benchmarks import yardstick
from benchmarks.known_answers import Known, judged

NAMES = {"j1 backlash": 0.97, "j1 coulomb_friction|stribeck_friction": 0.6}
ANSWER = {
    "verdict": "explained",
    "names": NAMES,
    "estimates": {"j1.kp_Nm_per_rad": [2.0, 0.1]},
    "errors": {"j1 in c": 0.004},
    "cpu_s": 8.0,
    "pace_s": 0.02,
}
TRUTH = {
    "verdict": "explained",
    "names": ["j1 backlash"],
    "allowed": ["j1 cogging"],
    "estimates": {"j1.kp_Nm_per_rad": 2.2},
}


def changed(**parts):
    """An answer with other parts."""
    return deepcopy(ANSWER) | parts


def moved(after):
    return [(move.kind, move.nearer) for move in yardstick.moves(ANSWER, after, TRUTH)]


def test_the_same_answer_did_not_move():
    small = changed(estimates={"j1.kp_Nm_per_rad": [2.02, 0.2]}, errors={"j1 in c": 0.00405})
    assert moved(small) == []


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ({"verdict": "ambiguous"}, [("verdict", False)]),
        ({"estimates": {"j1.kp_Nm_per_rad": [2.1, 0.1]}}, [("estimate", True)]),
        ({"estimates": {"j1.kp_Nm_per_rad": [1.9, 0.1]}}, [("estimate", False)]),
        ({"estimates": {}}, [("estimate", None)]),
        ({"errors": {"j1 in c": 0.0042}}, [("error", False)]),
        ({"errors": {}}, [("error", False)]),
        ({"names": {**NAMES, "j1 backlash": 0.85}}, [("names", False), ("probability", None)]),
        ({"names": {**NAMES, "j1 cogging": 0.95}}, [("names", None), ("probability", None)]),
    ],
)
def test_each_kind_of_change_is_reported(parts, expected):
    assert moved(changed(**parts)) == expected


def test_the_report_counts_what_held():
    worse = changed(verdict="ambiguous", errors={"j1 in c": 0.008}, cpu_s=8.0, pace_s=0.04)
    before = {"foreign/1": {"diagnose": ANSWER}, "foreign/2": {"diagnose": ANSWER}}
    after = {"foreign/1": {"diagnose": worse}, "foreign/2": {"diagnose": ANSWER}}
    lines = list(yardstick.report(before, after, {"foreign/1": TRUTH, "foreign/2": TRUTH}))
    assert "foreign/1 diagnose: verdict explained -> ambiguous (farther)" in lines
    assert "verdict: the same or nearer in 1 of 2" in lines
    assert "error: the same or nearer in 1 of 2" in lines
    assert "held-out errors of foreign, diagnose: +41.4 %" in lines
    assert any("16 -> 16 s, 0.67 at equal pace" in line for line in lines)
    assert not any(line.startswith("foreign/2") for line in lines)


def test_refused_input_is_an_answer(tmp_path):
    call = ["identify", "steps.csv", "--robot", "none.toml", "--out", str(tmp_path / "model.json")]
    message, _ = yardstick.called(call)
    assert message.startswith("sim2real identify: none.toml: found no such file")


def test_an_estimate_without_a_whole_interval_has_no_deviation():
    gains = {"kp_Nm_per_rad": 2.0, "kd_Nms_per_rad": 0.1, "latency_s": 0.02}
    intervals = {"kp_Nm_per_rad": [1.671, 2.329], "kd_Nms_per_rad": [0.05, None]}
    model = {"joints": {"j1": {**gains, "interval": intervals}}, "body": {}}
    found = dict(yardstick.stated(model, {"j1.latency_s": [0.02, 0.001]}))
    assert found["j1.kp_Nm_per_rad"] == [2.0, pytest.approx(0.2)]
    assert found["j1.kd_Nms_per_rad"] == [0.1, 0.0]
    assert found["j1.latency_s"] == [0.02, 0.001]


@pytest.mark.parametrize(
    ("effects", "named", "answer"),
    [
        (["j1 backlash"], [["j1 backlash"]], "right"),
        (["j1 backlash"], [["j1 backlash"], ["j1 coulomb_friction"]], "right"),
        (["j1 backlash"], [["j1 deadband", "j1 backlash"]], "group"),
        (["j1 backlash", "j2 backlash"], [["j1 backlash"]], "in part"),
        (["j1 backlash"], [["j1 coulomb_friction"]], "in part"),
        (["j1 backlash"], [], "silent"),
        (["j1 backlash"], [["j2 backlash"]], "wrong"),
        ([], [["j1 backlash"]], "wrong"),
        ([], [], "right"),
    ],
)
def test_an_answer_is_right_only_if_all_is_named_and_nothing_else(tmp_path, effects, named, answer):
    case = Known("", "", tmp_path, "*", effects=effects, also=["j1 coulomb_friction"])
    groups = [{"group": group, "probability": 0.8, "sizes": {}} for group in named]
    assert judged(case, {"verdict": "explained", "said": [], "named": groups})["answer"] == answer
