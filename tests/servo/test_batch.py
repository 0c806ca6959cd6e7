"""The batch: what it gives is what NumPy gives, one rollout at a time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from simulated import INERTIA, KP, column, row, traced

from sim2real.recording import Load
from sim2real.servo.batch import STEPS_PER_RADIAN, Batch, Problems
from sim2real.servo.rollout import coarse_substep, rollout

BLOCKS, DEEP = 4, 3
SUBSTEP = 1 / (STEPS_PER_RADIAN * np.sqrt(KP / INERTIA))


def gappy(trace):
    used = trace.used.copy()
    used[100:110] = False
    used[350] = False
    return replace(trace, position=np.where(used, trace.position, np.nan), used=used)


@pytest.fixture(scope="module")
def joints():
    """Two recordings of unequal length each, some with gaps, some with a pendulum."""
    weight = Load(INERTIA, 0.02, 0.05)
    long, short = traced(1, "long"), gappy(traced(2, "short", seconds=9.0))
    swing, again = traced(3, "long", load=weight), gappy(traced(4, "short", load=weight))
    return [[long, short], [swing, again]]


@pytest.fixture(scope="module")
def problems():
    """For each joint a servo with four variants, of which the second joint lacks the last."""
    base = row()
    variants = np.repeat(base[None], 5, axis=0)
    variants[1, 0] *= 1.001
    variants[2, 1] *= 1.01
    variants[3, column("coulomb_friction.torque_Nm")] = 0.02
    variants[4, column("backlash.gap_rad")] = 0.02
    theta = np.stack([variants, variants])
    theta[1, :, 0] = 1.05 * variants[:, 0]
    scale = np.array([[0, 1000.0, 10.0, 1.0, -1.0], [0, 1000.0, 5.0, 1.0, 0.0]])
    return Problems(np.array([0, 1], dtype=np.int32), theta, scale)


@pytest.fixture(scope="module")
def seen(joints, problems):
    return Batch(joints).evaluate(problems, blocks=BLOCKS, deep=DEEP, keep=True)


def simulated(theta, trace, coarse=False):
    """Angles with the load of the recording, shape (V, T)."""
    theta = theta.copy()
    theta[:, 3:5] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    substep = SUBSTEP * np.sqrt(KP / theta[0, 0])
    substep = coarse_substep(substep) if coarse else substep
    return rollout(theta, trace.t, trace.command, substep_s=substep)


def rows(problems, n, trace):
    """Residual and scaled differences of a problem on a recording, shape (V, T)."""
    angle = simulated(problems.theta[n], trace, coarse=True)
    values = (angle - angle[0]) * problems.scale[n][:, None]
    (own,) = simulated(problems.theta[n, :1], trace)
    values[0] = np.where(trace.used, own - np.where(trace.used, trace.position, 0), 0)
    return values


def counting(trace, lags):
    """Samples that are used, as are those before them that foretell them."""
    return np.array([k >= lags and trace.used[k - lags : k + 1].all() for k in range(trace.t.size)])


def whitened(values, trace, model):
    taps = np.concatenate([[1.0], -model])
    return np.where(counting(trace, model.size), lfilter(taps, [1.0], values, axis=-1), 0.0)


def test_residuals_are_rollout_minus_position(joints, problems, seen):
    for n, traces in enumerate(joints):
        for r, trace in enumerate(traces):
            expected = rows(problems, n, trace)[0]
            np.testing.assert_allclose(seen.residual[n, r, : trace.t.size], expected, atol=1e-10)
            assert (expected[~trace.used] == 0).all()


def test_gram_holds_the_inner_products_of_each_block(joints, problems, seen):
    assert seen.gram.shape == (2, 2 * BLOCKS, DEEP, 5)
    for n, traces in enumerate(joints):
        for r, trace in enumerate(traces):
            W = whitened(rows(problems, n, trace), trace, seen.autoregression[n])
            edges = np.arange(BLOCKS + 1) * trace.t.size // BLOCKS
            for b in range(BLOCKS):
                part = W[:, edges[b] : edges[b + 1]]
                expected = (part @ part.T)[:DEEP]
                got = seen.gram[n, r * BLOCKS + b]
                np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-10)


def test_servos_whose_angles_are_known_are_neither_simulated_nor_counted_again(
    joints, problems, seen
):
    batch = Batch(joints)
    angles = batch.evaluate(problems, alone=True).angles
    counted = batch.substeps.copy()
    again = batch.evaluate(problems, blocks=BLOCKS, deep=DEEP, known=angles)
    np.testing.assert_allclose(again.gram, seen.gram, rtol=1e-12)
    np.testing.assert_array_equal(batch.substeps, counted)
    moved = batch.evaluate(problems, known=1.2 * angles).square
    assert (moved[:, 0] > 2 * seen.square[:, 0]).all()


def test_an_unstable_variant_has_the_short_substeps(joints):
    """Damping that grows with the speed diverges where sub-steps are long."""
    theta = np.tile(row(), (1, 2, 1))
    theta[0, 1, column("quadratic_drag.coefficient_Nms2")] = 0.3
    problems = Problems(np.zeros(1, dtype=np.int32), theta, np.array([[0.0, 1.0]]))
    seen = Batch(joints[:1]).evaluate(problems)
    W = []
    for trace in joints[0]:
        angle = simulated(theta[0], trace)
        W.append(whitened(angle[1:] - angle[0], trace, seen.autoregression[0]))
    with np.errstate(invalid="ignore"):
        long = [simulated(theta[0], trace, coarse=True)[1] for trace in joints[0]]
    assert not np.isfinite(np.concatenate(long)).all()
    np.testing.assert_allclose(seen.square[0, 1], sum((w**2).sum() for w in W), rtol=1e-6)


def test_squares_are_those_of_all_variants(joints, problems, seen):
    lags = seen.autoregression.shape[1]
    for n, traces in enumerate(joints):
        assert seen.count[n] == sum(counting(x, lags).sum() for x in traces)
        W = [whitened(rows(problems, n, x), x, seen.autoregression[n]) for x in traces]
        expected = sum((w**2).sum(axis=1) for w in W)
        np.testing.assert_allclose(seen.square[n], expected, rtol=1e-6, atol=1e-12)


def test_the_noise_model_is_the_least_squares_one(joints, problems):
    free = Batch(joints, bounded=False).evaluate(problems, keep=True)
    lags = free.autoregression.shape[1]
    for n, traces in enumerate(joints):
        past, now = [], []
        for r, trace in enumerate(traces):
            residual = free.residual[n, r]
            for k in np.flatnonzero(counting(trace, lags)):
                past.append(residual[k - lags : k][::-1])
                now.append(residual[k])
        expected = np.linalg.lstsq(np.array(past), np.array(now), rcond=None)[0]
        np.testing.assert_allclose(free.autoregression[n], expected, atol=1e-5)


def test_a_sensor_may_wander_but_so_far(joints, problems):
    """A constant error is no noise: the whitening filter keeps some gain at frequency 0."""
    off = [[replace(x, position=x.position + 0.05) for x in traces] for traces in joints]
    bounded, free = (Batch(off, bounded=b) for b in (True, False))
    most = bounded.evaluate(problems).autoregression.sum(axis=1)
    assert (most <= 1 - bounded.least_gain + 1e-9).all()
    assert (free.evaluate(problems).autoregression.sum(axis=1) > most).all()


def test_a_given_noise_model_is_kept(joints, problems):
    batch = Batch(joints)
    white = batch.evaluate(problems, autoregression=np.zeros((2, batch.lags)), keep=True)
    assert (white.autoregression == 0).all()
    for n, traces in enumerate(joints):
        pairs = ((x, white.residual[n, r, : x.t.size]) for r, x in enumerate(traces))
        energy = sum(np.sum(error[counting(x, batch.lags)] ** 2) for x, error in pairs)
        assert white.square[n, 0] == pytest.approx(energy, rel=1e-12)


def test_joints_may_have_different_numbers_of_recordings(joints, problems):
    fewer = [joints[0], joints[1][:1]]
    found = Batch(fewer).evaluate(problems, blocks=BLOCKS)
    alone = Batch([joints[1][:1]]).evaluate(
        Problems(np.array([0], dtype=np.int32), problems.theta[1:], problems.scale[1:]),
        blocks=BLOCKS,
    )
    np.testing.assert_allclose(found.square[1], alone.square[0])
    assert (found.gram[1, BLOCKS:] == 0).all()


def test_one_of_the_deep_variants_may_not_be_there(joints, problems):
    scale = problems.scale.copy()
    scale[:, 1] = 0.0
    lacking = Problems(problems.joint, problems.theta, scale)
    deep, whole = (Batch(joints).evaluate(lacking, deep=deep) for deep in (DEEP, None))
    np.testing.assert_allclose(deep.gram[:, :, 2], whole.gram[:, :, 2])


def test_the_work_of_each_joint_is_counted(joints):
    batch = Batch(joints)
    theta = np.tile(row(), (2, 3, 1))
    theta[1, 1:, column("latency_s")] += 0.01
    problems = Problems(np.array([0, 1], dtype=np.int32), theta, np.array([[0, 1, 1], [0, 1, 0]]))
    batch.evaluate(problems)
    for j, servos in enumerate((3, 2)):
        fine, coarse = (
            sum((t.t[-1] - t.t[0]) / substep + 2 * t.t.size for t in joints[j])
            for substep in (SUBSTEP, coarse_substep(SUBSTEP))
        )
        assert batch.substeps[j] == pytest.approx(fine + servos * coarse, rel=0.01)
    once = batch.substeps.copy()
    batch.evaluate(problems)
    np.testing.assert_allclose(batch.substeps, 2 * once)
