import numpy as np
import pytest

from sim2real.noise import difference_noise, noise_floor, quantization_step
from sim2real.recording import read_recording

STEPS = (2 * np.pi / 4096, 0.0041888, 0.001)
RATE_HZ = 100.0


def times(rng: np.random.Generator, duration_s: float = 20.0) -> np.ndarray:
    steps = rng.normal(1 / RATE_HZ, 0.03 / RATE_HZ, int(duration_s * RATE_HZ))
    return np.cumsum(steps)


def held_angles(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Command and position: holds of 1.5 s, approached by a ringing joint 60 ms late."""
    command = rng.uniform(-0.6, 0.6, int(t[-1] / 1.5) + 1)[(t / 1.5).astype(int)]
    position = np.full(t.size, command[0])
    for k in np.flatnonzero(np.diff(command)) + 1:
        late = np.maximum(t - t[k] - 0.06, 0)
        ringing = np.exp(-15 * late) * (np.cos(25 * late) + 0.6 * np.sin(25 * late))
        after = np.arange(t.size) >= k
        position = np.where(after, command[k] + (command[k - 1] - command[k]) * ringing, position)
    return command, position


def measured(angle, sd, step, rng) -> tuple[np.ndarray, float]:
    """What a sensor reads, with six decimals, and the true standard deviation of its error."""
    read = angle + rng.normal(0, sd, angle.size)
    if step:
        read = step * np.round(read / step)
    return np.round(read, 6), float(np.hypot(sd, step / np.sqrt(12)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ratio", [0, 0.3, 1, 2])
@pytest.mark.parametrize("step", STEPS)
def test_step_is_found(step: float, ratio: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = times(rng)
    position, _ = measured(held_angles(t, rng)[1], ratio * step, step, rng)
    position[rng.random(t.size) < 0.1] = np.nan
    assert quantization_step(position - 0.1234) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("step", STEPS)
def test_step_is_found_from_few_levels(step: float) -> None:
    levels = np.array([0, 2, 5])  # neighbours never visited: the divisor of their gaps counts
    position = np.round(step * levels[np.arange(60) % 3], 6)
    assert quantization_step(position) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("decimals", [6, 9, 17])
@pytest.mark.parametrize("samples", [2, 3, 5, 10, 100, 5000])
def test_continuous_noise_has_no_step(samples: int, decimals: int) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = rng.normal(0, 10 ** rng.uniform(-5, -1), samples)
        assert quantization_step(np.round(noise, decimals)) == 0


RESTING = np.maximum(np.arange(0, 4, 0.01) - 1, 0.0)
NO_LEVELS = ([], [np.nan] * 5, [0.3], [0.3] * 50, [0.0] * 50 + [1.0], 0.3 * np.sin(RESTING))


@pytest.mark.parametrize("position", NO_LEVELS)
def test_no_step_without_two_close_levels(position: list[float]) -> None:
    assert quantization_step(np.array(position)) == 0


def swinging_angles(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Command and position, 70 ms late, that never rest."""
    return 0.5 * np.sin(2 * np.pi * t), 0.5 * np.sin(2 * np.pi * (t - 0.07))


@pytest.mark.parametrize(
    ("angles", "ratio"),
    [
        *((held_angles, ratio) for ratio in (0, 0.1, 0.5, 1, 2)),
        *((swinging_angles, ratio) for ratio in (0, 0.25, 0.5, 1, 2)),
    ],
)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step", STEPS[:2])
def test_noise_of_holds_and_of_motion(step: float, ratio: float, seed: int, angles) -> None:
    rng = np.random.default_rng(seed)
    t = times(rng)
    command, angle = angles(t, rng)
    position, truth = measured(angle, ratio * step, step, rng)
    position[rng.random(t.size) < 0.05] = np.nan
    assert noise_floor(t, command, position) == pytest.approx(truth, rel=0.25)


@pytest.mark.parametrize("drift_rad_s", [0, 0.001, -0.01])
@pytest.mark.parametrize("sd", [1e-4, 0.003])
def test_continuous_noise_and_slow_drift(sd: float, drift_rad_s: float) -> None:
    rng = np.random.default_rng(1)
    t = times(rng)
    position = 0.2 + drift_rad_s * t + rng.normal(0, sd, t.size)
    assert noise_floor(t, np.full(t.size, 0.2), position) == pytest.approx(sd, rel=0.1)


def test_motion_at_constant_command_is_no_noise() -> None:
    rng = np.random.default_rng(2)
    t = times(rng)
    pulled = 0.1 * np.sin(2 * np.pi * 4 * t) + rng.normal(0, 0.002, t.size)
    assert noise_floor(t, np.zeros(t.size), pulled) == pytest.approx(0.002, rel=0.25)


def test_never_below_the_quantization_error() -> None:
    t = np.arange(0, 5, 0.01)
    ramp = 0.001 * np.floor(t / 0.1)
    assert noise_floor(t, ramp, ramp) == pytest.approx(0.001 / np.sqrt(12), rel=0.01)


@pytest.mark.parametrize("samples", [0, 1, 2, 5, 6, 9])
def test_too_few_samples_say_little(samples: int) -> None:
    t = np.arange(samples) / 50
    assert noise_floor(t, np.zeros(samples), np.zeros(samples)) == 0
    assert difference_noise(t, np.zeros(samples)) == 0


@pytest.mark.parametrize("order", range(5))
def test_differences_cancel_polynomials(order: int) -> None:
    t = times(np.random.default_rng(4))
    assert difference_noise(t, (t / t[-1]) ** order) < 1e-12


@pytest.mark.parametrize("folder", ["bam_xl330", "sts3215_backlash"])
def test_steps_of_real_servos(realdata, folder: str) -> None:
    for csv in sorted((realdata / folder).glob("*.csv")):
        recording = read_recording(csv)
        for j, command in enumerate(recording.command.T):
            step = quantization_step(recording.position[:, j])
            assert step == pytest.approx(0.00153398, rel=0.01), csv.name
            noise = noise_floor(recording.t, command, recording.position[:, j])
            assert step / 4 < noise < 2 * step, csv.name


def test_commands_missing() -> None:
    rng = np.random.default_rng(3)
    t = times(rng)
    position = np.sin(t) + rng.normal(0, 0.01, t.size)
    assert noise_floor(t, np.full(t.size, np.nan), position) == pytest.approx(0.01, rel=0.15)
