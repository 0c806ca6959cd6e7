"""The plant of the sealed sets: a servo where nothing is hidden, and each effect shows."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="generating the sealed challenge needs numba")

FOLDER = Path(__file__).parents[2] / "datasets" / "concealed"


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    with scripts(FOLDER) as modules:
        yield modules


@pytest.fixture(scope="module")
def null_case(code):
    return code["cases"].draw_case("null", "", np.random.default_rng(8))


def exact_motion(servo, load, t, command):
    """torque = kp (command(t - latency) - q) - kd v on a bare inertia, by its two exponentials."""
    arrival = t + servo.latency_s
    times = np.union1d(t, arrival[arrival < t[-1]])
    held = command[np.maximum(np.searchsorted(arrival, times, side="right") - 1, 0)]
    A = np.array([[0.0, 1.0], [-servo.kp, -servo.kd]])
    A[1] /= load.inertia_kgm2
    rates, modes = np.linalg.eig(A.astype(complex))
    fade = np.exp(np.outer(np.diff(times), rates))
    propagators = np.einsum("ij,kj,jl->kil", modes, fade, np.linalg.inv(modes)).real
    states = [np.zeros(2)]
    for propagator, angle in zip(propagators, held[:-1], strict=True):
        rest = np.array([angle, 0.0])
        states.append(rest + propagator @ (states[-1] - rest))
    return np.array(states)[np.searchsorted(times, t), 0]


def test_with_nothing_hidden_it_is_a_pd_servo(code):
    case, _ = code["cases"].draw_case("null", "", np.random.default_rng(9))
    take = case.takes["b"]
    for j, servo in enumerate(case.servos):
        servo.loads["b"] = code["bench"].Load(servo.loads["b"].inertia_kgm2)
        world = case.world("b")
        world.joints["ripple_Nm"] = 0
        seen = world.motion(take.t, take.command, take.chance, [j]).seen[0]
        error = seen - exact_motion(servo, servo.loads["b"], take.t, take.command[:, j])
        assert np.sqrt(np.mean(error**2)) < 0.1e-3
        assert np.abs(error).max() < 0.6e-3


def test_nuisances_stay_below_the_noise(null_case):
    case, _ = null_case
    take = case.takes["a"]
    for j, servo in enumerate(case.servos):
        world = case.world("a")
        with_them = world.seen(take.t, take.command, take.chance, [j])[0]
        world.joints["ripple_Nm"] = 0
        world.joints["tooth_error_rad"] = 0
        apart = with_them - world.seen(take.t, take.command, take.chance, [j])[0]
        assert np.std(apart) < 0.35 * np.hypot(servo.sensor.white_rad, servo.sensor.wander_rad)


def test_duty_cycle_never_saturates_with_nothing_hidden(code):
    case, _ = code["cases"].draw_case("null", "", np.random.default_rng(2))
    for name, take in case.takes.items():
        motion = case.world(name).motion(take.t, take.command, take.chance, range(3))
        assert motion.figures[:, code["rollout"].DUTY_PEAK].max() < 1


def test_every_effect_changes_the_reading(code, null_case):
    case, scales = null_case
    take = case.takes["a"]
    cases, catalogue = code["cases"], code["catalogue"]
    plain = case.world("a").seen(take.t, take.command, take.chance, range(3))
    assert len(catalogue.EFFECTS) == 28
    for name, effect in catalogue.EFFECTS.items():
        hidden = cases.make_effect(name, 1, 1.0, scales[1], np.array([0.7, 0.5, 0.5]))
        world = code["world"].build_world(case.servos, "a", [hidden])
        seen = world.seen(take.t, take.command, take.chance, range(3))
        moved = np.sqrt(np.mean((seen - plain) ** 2, axis=1)) > 1e-4
        if name == "encoder_quantization":
            assert world.steps_rad[1] >= 2 * case.servos[1].sensor.step_rad
        elif effect.place == "joint":
            assert moved.tolist() == [False, True, False], name
        else:
            assert moved.all(), name


def test_the_noise_is_whitened(code):
    rng = np.random.default_rng(5)
    sensor = code["bench"].Sensor(0.0, 1e-3, 1.5e-3, 2.0)
    t = np.cumsum(rng.uniform(0.01, 0.03, size=20000))
    residual = code["sensor"].noise(sensor, t, rng)
    white, _ = code["likelihood"].whiten(residual, t, sensor, 0.0)
    assert np.std(white) == pytest.approx(1, abs=0.03)
    lagged = np.corrcoef(white[1:], white[:-1])[0, 1]
    assert abs(lagged) < 0.03
