"""Two sources of one topic contradict each other; noise, motion and steps do not."""

import numpy as np
import pandas as pd
import pytest
from good_input import message

from sim2real.importers.ros_messages import JOINT_STATE, Message, Stream, streams
from sim2real.importers.rosbag import check_sources

T = np.arange(0, 12, 0.008)
ANGLE = 0.5 * np.sin(2 * np.pi * (0.2 + 0.1 * T) * T) + np.random.default_rng(0).normal(
    0, 0.001, T.size
)


def woven(*series):
    """Messages of several sources in order of time."""
    t = np.concatenate([t for t, _ in series])
    order = np.argsort(t, kind="stable")
    x = np.concatenate([x for _, x in series])
    return pd.Series(x[order], (1e9 * t[order]).astype(np.int64))


def sources(series, *, commands=False):
    stream = Stream("run.bag", "/joint_states", [], series.index.to_numpy(), "header stamp")
    return check_sources(stream, {"pan": series}, commands=commands)


FREE = np.arange(0, 12, 0.0131)


def square(period_s):
    return np.where(T % period_s < period_s / 2, 0.0, 0.5)


@pytest.mark.parametrize(
    ("first", "second", "commands"),
    [
        (ANGLE, (T[::5], 0 * T[::5]), False),  # equal stamps
        (ANGLE, (T[::5] + 0.001, 0 * T[::5] + 0.3), False),
        (ANGLE, (T[::3] + 0.004, 0 * T[::3]), False),
        (ANGLE, (T + 0.004, ANGLE + 0.1), False),  # each agrees with the one two before it
        (ANGLE, (T + 0.004, 0.5 * np.sin(T)), False),
        (ANGLE, (FREE, 0.4 * np.cos(FREE)), False),  # at its own rate
        (ANGLE, (FREE, 0 * FREE), False),
        (square(1.0) + 0.1, (T[::4] + 0.0005, 0 * T[::4]), True),
        (square(1.0) + 0.1, (T + 0.004, 0 * T - 0.2), True),
    ],
)
def test_two_publishers_are_refused(first, second, commands):
    series = woven((T, first), second)
    place = ("run.bag: /joint_states: found", "two publishers", "s after the first message")
    line = message(lambda: sources(series, commands=commands), *place)
    assert commands or f" of {series.size} angles" in line and "angles of pan" in line


@pytest.mark.parametrize(
    ("t", "angle", "commands"),
    [
        (T, ANGLE, False),
        (T, 0 * T, False),
        (T, ANGLE + np.random.default_rng(1).normal(0, 0.02, T.size), False),  # a bad sensor
        (T, square(1.0), False),
        (T[::5], 0.3 * np.sin(2 * np.pi * T * T)[::5], False),  # past half the sampling rate
        (T, square(1.0), True),
        (T[::60], square(0.96)[::60], True),  # each message reverses the last one
        (T, np.random.default_rng(2).choice([-0.3, 0.3], T.size), True),  # binary noise
    ],
)
def test_one_publisher_is_left_alone(t, angle, commands):
    assert sources(woven((t, angle)), commands=commands) == []


def test_failed_readings_are_a_warning_with_a_number_and_a_time():
    failed = np.random.default_rng(3).random(T.size) < 0.03
    failed[:100] = False
    (warning,) = sources(woven((T, np.where(failed, 0, ANGLE + 0.7))))
    assert "two publishers, or failed readings" in warning
    number, first = int(np.sum(failed)), T[np.flatnonzero(failed)[0]]
    assert 0.75 * number < int(warning.split()[1]) <= number
    assert f"{first:.4g} s after the first message" in warning


def test_equal_stamps_with_other_angles_are_a_warning():
    coarse = np.floor(T / 0.016) * 0.016
    (warning,) = sources(woven((coarse, ANGLE)))
    assert "have the same time as the previous one and another angle of pan" in warning
    assert "coarse stamps" in warning
    assert sources(woven((T, ANGLE), (T[::3], ANGLE[::3]))) == []  # repeated as they are


def test_publishers_with_clocks_of_their_own_are_told_from_a_clock_set_back():
    def refused(*headers_s):
        messages = [Message(k, int(1e9 * t), JOINT_STATE, None) for k, t in enumerate(headers_s)]
        return message(lambda: streams("run.bag", {"/js": messages}), "/js", "clock never set back")

    assert "publisher" not in refused(10.0, 10.1, 5.2, 5.3)
    assert "one publisher of the topic" in refused(10.0, 5.1, 10.2, 5.3)
