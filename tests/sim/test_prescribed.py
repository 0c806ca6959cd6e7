"""Films: joints that are prescribed, and what their calibration and diagnosis are worth."""

import sys
from pathlib import Path

import numpy as np
import pytest
from drag_fish import PERIOD_S, ROBOT, angles, swum

from sim.calibration.swim_parameters import effect_parameters
from sim.inference.swims import Swim, simulated, with_values
from sim.twin.prescribed import by_film, follower
from sim.twin.twin import Coefficients
from sim2real.model import Model
from sim2real.velocity import body_velocity

BEFORE_S, SECONDS = 3.0, 8.0
LAW = Coefficients(8.228, 2.661, 0.998, 0.0, 1.676)
MODEL = Model(
    joints={joint.name: follower() for joint in ROBOT.joints}, body={"twin": vars(LAW)}
)  # a law of its own: the fitted one's may change
TIMES = PERIOD_S * np.arange(round(SECONDS / PERIOD_S))
RUN_UP = PERIOD_S * np.arange(-round(BEFORE_S / PERIOD_S), 0)


@pytest.fixture(scope="module")
def benchmark():
    """The modules of the real fish's page; benchmarks import each other by name."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    import filmed
    import left_out

    sys.path.pop(0)
    return filmed, left_out


def filmed_swim(beat_hz, heading, current, rng):
    """A film of the fish of rods in a pool whose water moves."""
    x, y, yaw = swum(beat_hz, SECONDS, BEFORE_S).T
    c, s = np.cos(heading), np.sin(heading)
    pose = np.stack([c * x - s * y, s * x + c * y, yaw + heading], axis=1)
    pose[:, :2] += np.outer(TIMES, current)
    pose += rng.standard_normal(pose.shape) * [0.0005, 0.0005, 0.005]
    motion = angles(np.concatenate([RUN_UP, TIMES]), beat_hz)
    signals = np.concatenate([body_velocity(TIMES, pose), motion[-TIMES.size :]], axis=1)
    return Swim(f"{beat_hz} Hz", TIMES, motion, pose[0], signals)


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


def test_what_another_simulation_hides_is_named_and_helps_films_left_out(benchmark):
    filmed, left_out = benchmark
    rng, current = np.random.default_rng(1), np.array([0.08, -0.10])
    films = [
        filmed.Film(filmed_swim(hz, heading, current, rng), hz)
        for hz, heading in ((0.9, 0.4), (1.5, 2.2))
    ]
    names = ("pool_current", "camera_latency")
    effects = [(name, tuple(effect_parameters(name))) for name in names]
    place = left_out.Pool(MODEL, by_film(ROBOT, run_up_s=BEFORE_S))
    found = left_out.leave_out(place, films, effects, 1)
    for split in found["splits"]:
        best, *others = split["effects"]
        assert best["effect"] == "pool_current"
        assert best["gain"] > left_out.ENOUGH
        assert all(one["gain"] < best["gain"] - 5 for one in others)
        assert best["probability"] > 0.9
    error = {name: rows.mean(axis=0) for name, rows in found["errors"].items()}
    assert error["calibrated"][2] < 0.5 * error["textbook"][2]
    assert error["diagnosed"][2] < error["calibrated"][2]
    assert error["diagnosed"][1] < 0.5 * error["calibrated"][1]
    assert np.array_equal(error["diagnosed"], error["with pool_current"])


def test_rivals_know_only_the_films_they_are_given(benchmark):
    filmed, _ = benchmark
    motion = angles(np.concatenate([RUN_UP, TIMES]), 1.0)

    def made(hz, speed):
        signals = np.zeros((TIMES.size, 5))
        signals[:, 0] = speed
        signals[:, 2] = 3 * np.gradient(motion[-TIMES.size :, 0], PERIOD_S)
        return filmed.Film(Swim("made", TIMES, motion, np.zeros(3), signals), hz)

    known, held = made(1.0, 0.1), made(2.0, 0.5)
    assert filmed.errors(filmed.by_beat([known], held), held)[[0, 3]] == pytest.approx(0.3)
    assert filmed.errors(filmed.by_regression([known], held), held)[2] == pytest.approx(0, abs=1e-6)


def test_the_film_of_a_real_fish(benchmark, realdata):
    filmed, left_out = benchmark
    from real_fish import floating

    from sim2real.robot import read_robot

    folder = realdata / "fishsim"
    robot = floating(read_robot(folder / "robot.toml"))
    one = filmed.film(folder, "f1_75", robot, 60.0)
    assert one.beat_hz == pytest.approx(1.313, abs=0.002)
    assert one.speeds[:, 0].mean() == pytest.approx(0.160, rel=0.03)
    assert one.angle == pytest.approx(one.swim.signals[:, 3:], abs=0.25)
    said = left_out.by_model(left_out.pool(robot), left_out.pool(robot).model, one)
    assert np.corrcoef(said[:, 2], one.speeds[:, 2])[0, 1] > 0.75
    noise = filmed.jitter(folder, "f1_75", robot, 60.0)
    assert np.all(noise[:3] < 0.2 * np.sqrt(np.mean(one.speeds**2, axis=0)))
    assert np.all(filmed.irregular(one)[:3] > 0)
