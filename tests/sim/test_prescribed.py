"""Films: joints that are prescribed."""

import numpy as np
import pytest

from sim.inference.swims import Swim, simulated, with_values
from sim.twin.prescribed import by_film, follower
from sim.twin.twin import Coefficients
from sim2real.model import Model
from sim2real.robot import Joint, Link, Robot, Servo

PERIOD_S, BEFORE_S, SECONDS = 0.02, 3.0, 8.0
ROBOT = Robot(
    "rods",
    (
        Link("head", 1.2, 0.30, 0.07, 0.10, com_m=0.15),
        Link("tail", 0.1, 0.15, 0.02, 0.10, com_m=0.075),
        Link("fin", 0.05, 0.10, 0.01, 0.10, com_m=0.05),
    ),
    tuple(Joint(f"j{k}", Servo("none", 5.0, 20.0, 0.001), (-1.4, 1.4)) for k in (1, 2)),
)
LAW = Coefficients(8.228, 2.661, 0.998, 0.0, 1.676)
MODEL = Model(
    joints={joint.name: follower() for joint in ROBOT.joints}, body={"twin": vars(LAW)}
)  # a law of its own: the fitted one's may change
TIMES = PERIOD_S * np.arange(round(SECONDS / PERIOD_S))
RUN_UP = PERIOD_S * np.arange(-round(BEFORE_S / PERIOD_S), 0)


def angles(t, beat_hz):
    """A wave that runs down the tail, shape (..., 2)."""
    phase = 2 * np.pi * beat_hz * np.asarray(t)[..., None] - [0.0, 1.4]
    return [0.35, 0.45] * np.sin(phase)


def test_joints_are_where_they_are_prescribed():
    heavy = with_values(MODEL, {"added_mass.ratio": 1.0, "twin.across": 20.0})
    motion = angles(np.concatenate([RUN_UP, TIMES]), 2.0)
    start = np.array([1.0, -2.0, 0.5])
    track = by_film(ROBOT, run_up_s=BEFORE_S)([MODEL, heavy], motion, start)
    assert track.shape == (2, TIMES.size, 5)
    assert track[:, 0, :3] == pytest.approx(np.array([start, start]))
    assert track[:, :, 3:] == pytest.approx(np.array([motion[-TIMES.size :]] * 2), abs=1e-4)


def test_a_film_begins_in_steady_swimming_whatever_the_pool_does():
    motion = angles(np.concatenate([RUN_UP, TIMES]), 1.0)
    drifts = with_values(MODEL, {"pool_current.u_m_s": 0.05})
    swim = Swim("made", TIMES, motion, np.array([0.0, 0.0, 1.2]), np.empty((0, 5)))
    still, moved = simulated(swim, [MODEL, drifts], by_film(ROBOT, run_up_s=BEFORE_S))
    first, last = still[:50, 0].mean(), still[-50:, 0].mean()
    assert first == pytest.approx(last, rel=0.02)
    shift = np.hypot(*(moved - still)[5:-5, :2].T)
    assert shift == pytest.approx(0.05, abs=0.003)
