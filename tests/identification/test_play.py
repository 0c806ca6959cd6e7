"""Play of a joint that two servos pull by elastic bands."""

from dataclasses import replace

import numpy as np
import pytest

from sim2real.identification.play import play_between_pulls
from sim2real.recording import Recording, read_recording

COUNT_RAD = 2 * np.pi / 4096


def pulled(gap_rad, stretch_rad):
    """j2 and j3 pull j1 in turn; it keeps half the gap on either side and stretches."""
    t = np.arange(0, 24, 0.1)
    phase = t % 4
    first, second = (phase >= 0.5) & (phase < 1.2), (phase >= 2.5) & (phase < 3.2)
    side = np.where(phase < 0.5, 1.0, np.where(phase < 2.5, -1.0, 1.0))
    angle = side * (gap_rad / 2 + stretch_rad * (first | second))
    command = np.stack([0 * t, np.where(first, 0.1, -0.4), np.where(second, -0.1, 0.4)], axis=1)
    position = np.stack([angle, command[:, 1], command[:, 2]], axis=1)
    ends = {"relaxed_and_tensioned_command_rad": {"j2": [-0.4, 0.1], "j3": [0.4, -0.1]}}
    metadata = {"external_load": ends}
    return Recording("a", "servo", ("j1", "j2", "j3"), t, command, position, metadata=metadata)


def test_play_is_where_the_shaft_rests_after_and_during_pulls():
    play = play_between_pulls(pulled(0.01, 0.004), "j1")
    assert play.unloaded_rad == pytest.approx(0.01)
    # The window of a pull ends as the band relaxes, a settling time after the command.
    assert 0.01 < play.loaded_rad <= 0.018 + 1e-9
    assert play_between_pulls(pulled(0.0, 0.004), "j1").unloaded_rad == pytest.approx(0.0)


def test_a_recording_without_pullers_has_no_play_between_pulls():
    made = pulled(0.01, 0.004)
    assert play_between_pulls(made, "j2") is None
    one = replace(made, joints=("j1",), command=made.command[:, :1], position=made.position[:, :1])
    assert play_between_pulls(replace(one, metadata={}), "j1") is None


@pytest.mark.parametrize(
    "name, joint, unloaded, loaded",
    [("single", "j1", 7.03, 14.78), ("nocomp2", "j1", 5.33, 7.67), ("nocomp2", "j2", 5.33, 7.67)],
)
def test_play_of_real_servos_is_within_15_percent_of_their_authors(
    realdata, name, joint, unloaded, loaded
):
    file = realdata / "sts3215_backlash" / f"{name}.csv"
    play = play_between_pulls(read_recording(file), joint)
    assert play.unloaded_rad / COUNT_RAD == pytest.approx(unloaded, rel=0.15)
    assert play.loaded_rad / COUNT_RAD == pytest.approx(loaded, rel=0.15)
