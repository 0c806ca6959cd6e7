"""Two sources of one topic contradict each other; noise, motion and steps do not."""

import numpy as np
import pandas as pd
import pytest
from good_input import message

from sim2real.importers.rosbag import JOINT_STATE, Message, Stream, check_source, streams

T = np.arange(0, 12, 0.008)
FREE = np.arange(0, 12, 0.0131)
RNG = np.random.default_rng(0)
ANGLE = 0.5 * np.sin(2 * np.pi * (0.2 + 0.1 * T) * T) + RNG.normal(0, 0.001, T.size)


def sources(*series):
    """Warnings of the messages of several sources, in order of time."""
    t, x = (np.concatenate(values) for values in zip(*series, strict=True))
    order = np.argsort(t, kind="stable")
    woven = pd.Series(x[order], (1e9 * t[order]).astype(np.int64))
    stream = Stream("run.bag", "/joint_states", [], woven.index.to_numpy(), "header stamp")
    return check_source(stream, {"pan": woven})


@pytest.mark.parametrize(
    "second",
    [
        (T[::5], 0 * T[::5]),  # equal stamps
        (T[::5] + 0.001, 0 * T[::5] + 0.3),
        (T[::3] + 0.004, 0 * T[::3]),
        (T + 0.004, ANGLE + 0.1),  # each agrees with the one two before it
        (T + 0.004, 0.5 * np.sin(T)),
        (FREE, 0.4 * np.cos(FREE)),  # at its own rate
    ],
)
def test_two_publishers_are_refused(second):
    place = ("run.bag: /joint_states: found", "two publishers", "s after the first message")
    line = message(lambda: sources((T, ANGLE), second), *place)
    assert f" of {T.size + second[0].size} angles of pan" in line


@pytest.mark.parametrize(
    ("t", "angle"),
    [
        (T, ANGLE),
        (T[:2], ANGLE[:2]),
        (T, ANGLE + RNG.normal(0, 0.02, T.size)),  # a bad sensor
        (T, np.where(T % 1 < 0.5, 0.0, 0.5)),
        (T[::5], 0.3 * np.sin(2 * np.pi * T * T)[::5]),  # past half the sampling rate
    ],
)
def test_one_publisher_is_left_alone(t, angle):
    assert sources((t, angle)) == []


def test_failed_readings_are_a_warning_with_a_number_and_a_time():
    failed = np.random.default_rng(3).random(T.size) < 0.03
    failed[:100] = False
    (warning,) = sources((T, np.where(failed, 0, ANGLE + 0.7)))
    assert "two publishers, or failed readings" in warning
    number, first = int(np.sum(failed)), T[np.flatnonzero(failed)[0]]
    assert 0.75 * number < int(warning.split()[1]) <= number
    assert f"{first:.4g} s after the first message" in warning


def test_publishers_with_clocks_of_their_own_are_told_from_a_clock_set_back():
    def refused(*headers_s):
        messages = [Message(k, int(1e9 * t), JOINT_STATE, None) for k, t in enumerate(headers_s)]
        return message(lambda: streams("run.bag", {"/js": messages}), "/js", "clock never set back")

    assert "publisher" not in refused(10.0, 10.1, 5.2, 5.3)
    assert "one publisher of the topic, not two" in refused(10.0, 5.1, 10.2, 5.3)
