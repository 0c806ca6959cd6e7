"""Many fits in step: known parameters come back, bounds hold, and no fit disturbs another."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from simulated import INERTIA, KD, KP, LATENCY, column, row, traced

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.identification import advice
from sim2real.identification.identify import identify
from sim2real.identification.priors import gains
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.search import fit
from sim2real.identification.servo_problem import Servos, minimise, variants
from sim2real.identification.uncertainty import Uncertainty
from sim2real.inference.parameters import Parameter
from sim2real.recording import read_recording
from sim2real.robot import Servo, read_robot
from sim2real.servo.batch import Batch
from sim2real.servo.prediction import predict

FRICTION = 0.05
TRUTH = np.array([KP, KD, LATENCY, FRICTION])
COLUMNS = np.array([0, 1, 2, column("coulomb_friction.torque_Nm")], dtype=np.int32)
UNIT = np.array([2.0, 0.05, 0.05, 0.05])
LOW, HIGH = np.zeros(4), np.array([50.0, 1.0, 0.3, 1.0])


def servos(*starts, low=LOW, high=HIGH, joint=None):
    """Servos that start from rows of kp, kd, latency and friction."""
    N = len(starts)
    theta = np.repeat(row()[None], N, axis=0)
    theta[:, COLUMNS] = starts
    repeated = (np.repeat(np.asarray(x)[None], N, axis=0) for x in (COLUMNS, UNIT, low, high))
    joint = np.zeros(N) if joint is None else joint
    return Servos(np.asarray(joint, dtype=np.int32), theta, *repeated)


FAR = (1.7, 0.045, 0.06, 0.01)


@pytest.fixture(scope="module")
def batch():
    rubbing = {"coulomb_friction": {"torque_Nm": FRICTION}}
    first, second = (
        [traced(k, "a", **rubbing), traced(k + 1, "b", seconds=10.0, **rubbing)] for k in (1, 3)
    )
    return Batch([first, second])


@pytest.fixture(scope="module")
def fits(batch):
    return minimise(batch, servos(FAR, FAR, joint=[0, 1]), iterations=40, blocks=5)


def spread(fits, n):
    """Standard deviations of the free parameters."""
    normal = fits.gram[n].sum(axis=0)[1:, 1:]
    variance = fits.error2[n] / fits.count[n]
    return np.sqrt(variance * np.diag(np.linalg.inv(normal))) * UNIT


def test_known_parameters_come_back_and_what_is_left_is_noise(fits):
    for n in range(2):
        error = np.abs(fits.servos.theta[n, COLUMNS] - TRUTH)
        assert (error < 4 * spread(fits, n)).all()
        assert (spread(fits, n) < 0.03 * TRUTH).all(), "these recordings are telling"
    np.testing.assert_allclose(np.sqrt(fits.error2 / fits.count), 0.0015, rtol=0.06)
    expected = -0.5 * fits.count * np.log(fits.error2 / fits.count)
    np.testing.assert_allclose(fits.loglikelihood, expected)
    total = fits.gram.sum(axis=1)
    slope, curvature = total[:, 1:, 0], np.diagonal(total[:, 1:, 1:], axis1=1, axis2=2)
    share = slope**2 / (curvature * fits.error2[:, None])
    assert (share.max(axis=1) * fits.count < 0.3).all(), "no step is worth making"


def test_white_noise_can_be_asked_for_and_inertia_comes_from_the_recording(batch):
    """Whatever the row says of the load, the recording knows better."""
    given = servos(FAR)
    given.theta[:, 3] = 7 * INERTIA
    white = minimise(batch, given, iterations=40, white=True)
    assert (white.autoregression == 0).all()
    np.testing.assert_allclose(white.servos.theta[0, COLUMNS], TRUTH, rtol=0.05)


def test_a_varied_servo_that_diverges_leaves_the_other_parameters_determined(batch, monkeypatch):
    evaluate = batch.evaluate

    def diverging(problems, **options):
        normal = evaluate(problems, **options)
        if not options.get("alone"):
            normal.gram[:, :, 2] = normal.gram[:, :, :, 2] = np.nan
        return normal

    monkeypatch.setattr(batch, "evaluate", diverging)
    fits = minimise(batch, servos(FAR), iterations=20, blocks=5)
    assert np.isfinite(fits.variances).all()
    assert fits.servos.theta[0, 1] == FAR[1]
    assert (fits.variances[[0, 2, 3]] > 0).all()


def test_variants_step_towards_the_inside():
    edge = servos(HIGH, LOW)
    shifted = variants(edge)
    moved = shifted.theta[:, 1:, :][:, range(4), COLUMNS]
    assert (moved[0] < HIGH).all()
    assert (moved[1] > LOW).all()
    step = moved - np.stack([HIGH, LOW])
    np.testing.assert_allclose(shifted.scale[:, 1:] * step, np.tile(UNIT, (2, 1)))


NOISE_RAD = 0.001
ROBOT = simulated.robot("j1", servo=Servo("s", 9.0, 99.0, 0.0))


def found(fitted, **effects):
    """The model with effects ``fitted`` of two recordings of a servo that has ``effects``."""
    how = {"noise": NOISE_RAD, **effects}
    given = [simulated.recording(seed, name, **how) for seed, name in enumerate("ab")]
    return identify(given, ROBOT, effects=fitted)


@pytest.mark.parametrize(
    "effects",
    [
        {"coulomb_friction": {"torque_Nm": 0.04}},
        {"torque_saturation": {"limit_Nm": 0.6}},
        {"backlash": {"gap_rad": 0.03, "rotor_inertia_kgm2": 5e-4}},
        {"rate_limit": {"limit_rad_s": 4.0}},
        {"load_friction": {"ratio": 0.2}, "sensor_offset": {"offset_rad": 0.02}},
    ],
    ids=lambda effects: "+".join(effects),
)
def test_a_known_effect_is_recovered_with_the_gains(effects):
    model = found(list(effects), **effects)
    joint, figures = model.joints["j1"], model.fit["j1.position_rad"]
    assert joint.kp_Nm_per_rad == pytest.approx(simulated.KP, rel=0.03)
    assert joint.latency_s == pytest.approx(simulated.LATENCY, abs=0.002)
    for fitted in joint.effects:
        for name, value in effects[fitted.effect].items():
            assert fitted.parameters[name] == pytest.approx(value, rel=0.1)
            low, high = joint.interval[f"{fitted.effect}.{name}"]
            assert low < fitted.parameters[name] < high
    assert figures["heldout"] < 1.15 * NOISE_RAD
    assert figures["heldout_without_effects"] > 1.5 * figures["heldout"]


def test_a_controller_of_the_output_is_found():
    play = {"gap_rad": 0.03, "rotor_inertia_kgm2": 5e-4, "output_friction_Nm": 0.03}
    joint = found(["backlash"], backlash=play | {"control_on_output": 1.0}).joints["j1"]
    assert joint.effects[0].parameters == pytest.approx(play | {"control_on_output": 1.0}, rel=0.1)


def test_an_effect_that_is_not_there_comes_out_as_nothing():
    joint = found(["coulomb_friction"]).joints["j1"]
    assert joint.effects[0].parameters["torque_Nm"] < 0.002
    assert joint.interval["coulomb_friction.torque_Nm"][0] == 0.0
    assert joint.kp_Nm_per_rad == pytest.approx(simulated.KP, rel=0.02)


def test_parameters_scale_with_the_servo():
    torque, inertia, gap = (
        named(effect).parameters[0]
        for effect in ("coulomb_friction", "unmodelled_inertia", "backlash")
    )
    assert scaled(torque, 4.0, 0.002).typical == 2 * torque.typical
    assert scaled(inertia, 4.0, 0.004).typical == 2 * inertia.typical
    assert scaled(gap, 4.0, 0.004) == gap


NAMES = ("kp_Nm_per_rad", "motor.rotor_inertia_kgm2")


def fit_with(others):
    """A fit of kp 2 and a rotor of 0.002, with other minima that explain the data as well."""
    free = Parameter(NAMES[0], 0.0, 9.0, 1.0), Parameter(NAMES[1], 0.0, 1.0, 1e-3)
    trace = simulated.traced(1, seconds=1.0)
    problem = ServoProblem([trace], plain_row(2.0, 0.1, 0.0), free)
    none = np.zeros(trace.t.size), np.zeros((trace.t.size, 2))
    x = np.array([[2.0, 0.002], *others]) / problem.unit
    return Fit(problem, x[0], *none, 1.0, 1.0, True, x[1:], np.zeros(len(others)))


def test_an_optimum_outside_the_interval_is_named_with_what_differs():
    half_width = np.array([0.1, 0.0001]) / [1.0, 1e-3]
    spread = Uncertainty(np.eye(2), half_width, (), 1.0, 0.9)
    (note,) = advice.on_optima(fit_with([[2.05, 0.003]]), spread)
    assert "rotor inertia 0.003 instead of 0.002" in note
    assert "kp" not in note
    assert advice.on_optima(fit_with([[2.09, 0.00209]]), spread) == []
    assert advice.on_optima(fit_with([]), spread) == []


def test_a_fit_ends_early_where_it_does_not_come_below_its_rival():
    problem = ServoProblem([simulated.traced(1)], plain_row(1.0, 0.05, 0.05), gains(0.002))
    start = plain_row(1.05 * simulated.KP, simulated.KD, simulated.LATENCY)[None]
    best = fit(problem, start)
    worse = replace(best, error=best.error + 0.01)
    assert best.converged and fit(problem, start, rival=(worse, 5.0)).converged
    assert not fit(problem, start, rival=(best, 5.0)).converged


@pytest.mark.parametrize("gain, held_out", [(200, "up_and_down"), (800, "lift_and_drop")])
def test_a_real_servo_is_predicted_on_a_trajectory_that_no_fit_used(realdata, gain, held_out):
    folder = realdata / "bam_xl330"
    paths = sorted(folder.glob(f"xl330_kp{gain}_*.csv"))
    recordings = [read_recording(path) for path in paths]
    (scored,) = (r for r in recordings if r.name.endswith(held_out))
    robot = read_robot(folder / "robot.toml")
    model = identify(recordings, robot, held_out=scored.name, refit=False)
    sent = {"j1": scored.command[:, 0]}
    angle = predict(model, scored.t, sent, scored.loads)["j1"]
    error = (angle - scored.position[:, 0])[: scored.powered(0)]
    assert np.sqrt(np.nanmean(error**2)) < 0.06
    joint = model.joints["j1"]
    per_rad = joint.kp_Nm_per_rad / joint.motor["stall_torque_Nm"]
    assert per_rad == pytest.approx(0.00287 * gain, rel=0.05)  # duty per radian, as reported
