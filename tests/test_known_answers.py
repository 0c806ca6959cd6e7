import pytest

from benchmarks.known_answers import Known, judged


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
