"""Controllers: the generator's waves, guidance, observers, tables; and who begins anew."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from rl.controllers import Controller
from rl.controllers.classical import (
    CONTROL_S,
    PACES,
    ADRCGains,
    CentralPatternGenerator,
    DisturbanceRejection,
    Gait,
    Gliding,
    LineOfSight,
    PNLGains,
    ProportionalNavigation,
    TransientProfile,
    line_of_sight_rate,
    tuned,
)
from rl.controllers.discrete_cpg import TABLE, DiscreteCPG, DiscreteCPGEnv
from sim2real.errors import InputError

LIMITS = np.array([[-0.8, 0.8], [-0.7, 0.8], [-0.8, 0.6]])
WIDE = np.array([[-9.0, 9.0]] * 3)
PNL = PNLGains(1.5, 0.5, 0.8, 0.9, 0.6, 0.3, 0.5, 0.8, 0.3)
ADRC = ADRCGains(1.5, 0.5, 0.8, 0.9, 0.6, 0.3, 2.0, 1.0, 8.0, 2.0, 10.0, 5.0)
PNLS, ADRCS = ProportionalNavigation, DisturbanceRejection
BOTH = pytest.mark.parametrize(("kind", "gains"), [(PNLS, PNL), (ADRCS, ADRC)])
Kind = Callable[..., Controller]


def seen(n: int, *, target: tuple[float, float] | None = None, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = rng.normal(0, 0.3, (n, 11)).astype(np.float32)
    if target is not None:
        rows[:, 9:] = target
    return rows


def mirrored(observation: np.ndarray) -> np.ndarray:
    """Left for right: sway, yaw rate, joints, their rates, the target's side."""
    return observation * np.array([1, -1, -1, *[-1] * 6, 1, -1], dtype=np.float32)


def waves(gait: Gait, seconds: float, limits: np.ndarray = WIDE, n: int = 2) -> np.ndarray:
    generator = CentralPatternGenerator(limits, n)
    return np.array([generator.step(gait) for _ in range(round(seconds / CONTROL_S))])


class TestGenerator:
    @pytest.mark.parametrize(("frequency", "lag"), [(0.5, 1.2), (1.0, -0.3), (2.5, 0.8)])
    def test_swims_what_is_asked(self, frequency: float, lag: float) -> None:
        n = np.array([1.0, 0.5])  # two robots, two amplitudes
        angle = waves(Gait(frequency, 0.6 * n, 0.5, lag, 0.2 * n), 8.0)[-200:]
        t = CONTROL_S * np.arange(200)  # four seconds: whole beats of every frequency
        wave = np.exp(-2j * np.pi * frequency * t)
        part = 2 * np.einsum("t,tej->ej", wave, angle) / 200
        assert np.abs(part) == pytest.approx(np.outer(n, [0.3, 0.45, 0.6]), rel=1e-3)
        assert angle.mean(axis=0) == pytest.approx(np.outer(n, [0.2] * 3), abs=1e-3)
        assert np.angle(part[:, :-1] / part[:, 1:]) == pytest.approx(lag, abs=1e-3)
        rest = angle - angle.mean(axis=0) - np.real(part / wave[:, None, None])
        assert np.abs(rest).max() < 2e-3  # no other frequency in it

    def test_glides_without_overshoot_as_the_equation_says(self) -> None:
        part = Gliding(np.zeros((1, 1)))
        got = [float(part.step(np.ones((1, 1)))[0, 0]) for _ in range(50)]
        t = 0.02 * np.arange(1, 51)
        assert got == pytest.approx(1 - (1 + 12 * t) * np.exp(-12 * t))

    def test_begins_from_the_angles_given(self) -> None:
        generator = CentralPatternGenerator(LIMITS, 2)
        row = np.array([[0.0] * 3 + [0.3, 0.2, 0.1] + [0.0] * 5] * 2)
        generator.reset(row, mask=np.array([True, False]))
        first = generator.step(Gait(1.0, 0.5))
        assert first[0] == pytest.approx([0.3, 0.2, 0.1], abs=0.02)
        assert first[1] == pytest.approx([0.0] * 3, abs=0.02)


class TestLineOfSight:
    def test_rate_is_that_of_the_geometry(self) -> None:
        rng = np.random.default_rng(1)
        position, heading, velocity = rng.normal(size=2), 0.7, np.array([0.3, -0.1])
        target, h = np.array([1.2, -0.4]), 1e-6
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s], [-s, c]])
        row = np.zeros((1, 11))
        row[0, :2], row[0, 9:] = velocity, turn @ (target - position)
        later = position + h * turn.T @ velocity
        angles = [np.arctan2(*(target - p)[::-1]) for p in (position, later)]
        assert line_of_sight_rate(row)[0] == pytest.approx((angles[1] - angles[0]) / h, rel=1e-4)

    def test_a_turn_goes_on_past_the_point_behind(self) -> None:
        rows = np.zeros((5, 1, 11))
        angle = np.radians([170, 179, 185, 220, 230])
        rows[:, 0, 9:] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sight = LineOfSight(0.0, rows[0])
        met = [170.0]
        for row in rows[1:]:
            sight.update(row)
            met.append(np.degrees(sight.smooth[0]))
        assert met == pytest.approx([170, 179, 185, 220, -130])

    def test_smooths_over_its_time_constant(self) -> None:
        sight = LineOfSight(0.5, seen(1, target=(1.0, 0.0)))
        for _ in range(25):
            sight.update(seen(1, target=(1.0, 1.0)))
        assert sight.smooth[0] == pytest.approx(np.pi / 4 * (1 - np.exp(-1)))
        assert sight.bearing[0] == pytest.approx(np.pi / 4)


class TestADRC:
    def test_profile_is_the_quickest_without_overshoot(self) -> None:
        profile = TransientProfile(2, np.array([4.0, 1.0]))
        met, rates = [], []
        for _ in range(200):
            profile.update(np.array([1.0, -1.0]))
            met.append(profile.value)
            rates.append(profile.rate)
        push = np.abs(np.diff(rates, axis=0) / CONTROL_S).max(axis=0)
        assert push == pytest.approx([4.0, 1.0])
        assert met[-1] == pytest.approx([1.0, -1.0], abs=1e-3)
        assert np.abs(met).max() < 1.001
        arrived = (np.abs(met) > 0.99).argmax(axis=0) * CONTROL_S
        assert arrived == pytest.approx(2 * np.sqrt(1.0 / np.array([4.0, 1.0])), abs=0.15)

    @pytest.mark.parametrize("drift", [0.0, 1.0])
    def test_turns_a_plant_to_its_target_against_a_disturbance(self, drift: float) -> None:
        still = replace(ADRC, amplitude_rad=0.0)
        controller = DisturbanceRejection(LIMITS, still)
        target = np.array([2.0, -2.0])
        heading, rate = np.zeros(2), np.zeros(2)
        for _ in range(600):
            row = np.zeros((2, 11), dtype=np.float32)
            row[:, 2] = rate
            row[:, 9:] = np.stack([np.cos(target - heading), np.sin(target - heading)], axis=1)
            bend = -controller.act(row).mean(axis=1)
            rate = rate + CONTROL_S * (5.0 * bend + drift - rate)
            heading = heading + CONTROL_S * rate
        assert heading == pytest.approx(target, abs=0.02)


class TestBoth:
    @pytest.mark.parametrize("pace", PACES)
    @pytest.mark.parametrize(("kind", "gains"), [(PNLS, PNLGains), (ADRCS, ADRCGains)])
    def test_tuned_ones_keep_inside_the_limits(self, kind: Kind, gains: type, pace: str) -> None:
        controller = kind(LIMITS, tuned("pnl" if kind is PNLS else "adrc", gains, pace))
        angle = np.array([controller.act(seen(4, seed=k)) for k in range(200)])
        assert (angle.dtype, angle.shape) == (np.float32, (200, 4, 3))
        assert (angle >= LIMITS[:, 0].astype(np.float32)).all()
        assert (angle <= LIMITS[:, 1].astype(np.float32)).all()
        assert np.ptp(angle, axis=0).min() > 0.1

    @BOTH
    def test_is_the_same_left_and_right(self, kind: Kind, gains) -> None:
        one, other = kind(WIDE, gains), kind(WIDE, gains)
        for k in range(100):
            row = seen(5, seed=k)
            assert one.act(row) == pytest.approx(-other.act(mirrored(row)), abs=1e-5)

    @BOTH
    def test_each_robot_has_its_own_gains(self, kind: Kind, gains) -> None:
        pair = replace(gains, amplitude_rad=np.array([0.2, 0.5]), bend_rad=np.array([0.3, 0.6]))
        both, alone = kind(LIMITS, pair), kind(LIMITS, gains)
        for k in range(60):
            row = seen(2, seed=k)
            angle, same = both.act(row), alone.act(row)
            assert (angle[1] == same[1]).all()
        assert (angle[0] != same[0]).any()


def gaits(limits: np.ndarray, _: object) -> DiscreteCPG:
    env = DiscreteCPGEnv(Counting([99]))
    return DiscreteCPG(PPO("MlpPolicy", env, n_steps=8, batch_size=8, seed=0), limits)


@pytest.mark.parametrize(("kind", "gains"), [(PNLS, PNL), (ADRCS, ADRC), (gaits, None)])
def test_robots_begin_anew_after_a_reset(kind: Kind, gains) -> None:
    reset, fresh = kind(LIMITS, gains), kind(LIMITS, gains)
    for k in range(43):
        reset.act(seen(4, seed=k))
    reset.reset()
    for k in range(43, 80):
        assert (reset.act(seen(4, seed=k)) == fresh.act(seen(4, seed=k))).all()


def test_a_missing_gain_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_text("[pnl.middle]\nfrequency_hz = 1.0\namplitude_rad = 'big'\n")
    with pytest.raises(InputError, match=r"pnl\.middle\.amplitude_rad"):
        tuned("pnl", PNLGains, path=tmp_path / "t.toml")


class Counting(VecEnv):
    """Robot e ends an episode every ``ends[e]`` steps; rewards 1 a step; rows say who and when."""

    def __init__(self, ends: list[int]) -> None:
        box = spaces.Box(-100, 100, (11,), dtype=np.float32)
        super().__init__(len(ends), box, spaces.Box(-1, 1, (3,), dtype=np.float32))
        self.ends, self.age, self.sent = np.array(ends), np.zeros(len(ends), int), []

    def _rows(self) -> np.ndarray:
        rows = np.zeros((self.num_envs, 11), dtype=np.float32)
        rows[:, 0], rows[:, 1] = np.arange(self.num_envs), self.age
        return rows

    def reset(self) -> np.ndarray:
        self.age[:] = 0
        return self._rows()

    def step_async(self, actions: np.ndarray) -> None:
        self.sent.append(actions)

    def step_wait(self):
        self.age += 1
        done = self.age == self.ends
        rows = self._rows()
        infos = [{"terminal_observation": rows[e]} if end else {} for e, end in enumerate(done)]
        self.age[done] = 0
        return self._rows(), np.ones(self.num_envs, np.float32), done, infos

    def get_attr(self, attr_name, indices=None):
        return [{"low": LIMITS[:, 0], "high": LIMITS[:, 1]}.get(attr_name)] * self.num_envs

    def close(self): ...
    def set_attr(self, attr_name, value, indices=None): ...
    def env_method(self, method_name, *args, indices=None, **kwargs): ...
    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


class TestDiscrete:
    def test_a_choice_holds_and_no_row_is_swapped(self) -> None:
        inner = Counting([3, 10, 14, 99])
        env = DiscreteCPGEnv(inner)
        assert env.reset().shape == (4, 13)
        row, reward, done, infos = env.step(np.array([0, 5, 15, 7]))
        assert reward.tolist() == [3, 10, 10, 10]
        assert done.tolist() == [True, True, False, False]
        assert row[:, :2].tolist() == [[0, 1], [1, 0], [2, 10], [3, 10]]
        assert infos[0]["terminal_observation"][:2].tolist() == [0, 3]
        assert infos[1]["terminal_observation"].shape == (13,)
        assert np.hypot(*row[:, -2:].T) == pytest.approx(1.0)
        _, reward, done, _ = env.step(np.array([0, 5, 15, 7]))
        assert reward.tolist() == [2, 10, 4, 10]
        assert done.tolist() == [True, True, True, False]
        assert np.abs(inner.sent).max() <= 1
        middle = -(LIMITS[:, 0] + LIMITS[:, 1]) / (LIMITS[:, 1] - LIMITS[:, 0])
        assert inner.sent[-1][2] == pytest.approx(middle)  # the last row of the table: still

    def test_controller_does_what_the_wrapper_did(self) -> None:
        env = DiscreteCPGEnv(Counting([99, 99, 99]))
        model = PPO("MlpPolicy", env, n_steps=8, batch_size=24, seed=0, device="cpu")
        controller = DiscreteCPG(model, LIMITS)
        row, plain = env.reset(), env.venv.reset()
        for _ in range(3):
            choice = model.predict(row, deterministic=True)[0]
            first = len(env.venv.sent)
            row, *_ = env.step(choice)
            for scaled in env.venv.sent[first:]:
                angle = controller.act(plain)
                low, high = LIMITS.T
                assert 2 * (angle - low) / (high - low) - 1 == pytest.approx(scaled, abs=1e-5)
                plain = plain + np.eye(11, dtype=np.float32)[1]
        assert choice.max() < len(TABLE)
