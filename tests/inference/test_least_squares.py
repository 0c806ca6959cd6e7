"""The fitter: scipy's answers, one problem at a time or many, within bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares, lsq_linear

from sim2real.inference.least_squares import (
    Expansion,
    cannot_win,
    minimise,
    rms,
    robust_loss,
    robust_scale,
)
from sim2real.inference.parameters import Parameter

T = np.linspace(0, 3, 300)
TRUTH = np.array([[2.0, 1.5], [1.0, 0.4], [3.0, 2.5]])


def decay(x):
    """A decaying exponential with the derivatives by its two parameters."""
    wave = np.exp(-x[1] * T)
    return x[0] * wave, np.stack([wave, -x[0] * T * wave], axis=1)


def noisy(n):
    return decay(TRUTH[n])[0] + 0.02 * np.random.default_rng(n).standard_normal(T.size)


def squares(error, slope, **aside):
    """Half the sum of squares of residuals (N, n) with derivatives (N, n, F)."""
    steep, bent = (np.einsum("nkf,nk...->nf...", slope, x) for x in (error, slope))
    return Expansion(0.5 * np.sum(error**2, axis=1), steep, bent, aside)


def expand(x, index):
    pairs = [decay(point) for point in x]
    error = np.array([angle - noisy(n) for (angle, _), n in zip(pairs, index, strict=True)])
    return squares(error, np.array([slope for _, slope in pairs]), which=np.array(index))


LOW, HIGH = np.zeros((3, 2)), np.full((3, 2), 10.0)
START = np.ones((3, 2))


def by_scipy(n, **options):
    return least_squares(lambda x: decay(x)[0] - noisy(n), START[n], xtol=1e-12, **options).x


def test_many_problems_in_step_are_those_of_scipy():
    found = minimise(expand, START, LOW, HIGH, settled=1e-10)
    assert found.converged.all()
    for n in range(3):
        np.testing.assert_allclose(found.x[n], by_scipy(n), rtol=1e-5)
    np.testing.assert_array_equal(found.expansion.aside["which"], [0, 1, 2])


def test_no_problem_disturbs_another():
    together = minimise(expand, START, LOW, HIGH)
    for n in range(3):
        alone = minimise(lambda x, _, n=n: expand(x, [n] * len(x)), START[:1], LOW[:1], HIGH[:1])
        np.testing.assert_array_equal(alone.x[0], together.x[n])


def test_a_parameter_that_is_pushed_against_its_bound_stays_there():
    high = np.tile([1.4, 10.0], (3, 1))
    found = minimise(expand, START, LOW, high, settled=1e-10)
    assert found.x[0, 0] == 1.4
    expected = by_scipy(0, bounds=([0, 0], [1.4, 10]))
    np.testing.assert_allclose(found.x[0], expected, rtol=1e-4)


def test_correlated_parameters_reach_the_minimum_within_bounds():
    """A step that is cut at one bound alone can be uphill, far from the minimum."""
    rng = np.random.default_rng(0)
    common = rng.normal(size=(30, 40, 1))
    matrix = 10 * (common + 0.1 * rng.normal(size=(30, 40, 3)))
    target = np.einsum("nkf,nf->nk", matrix, rng.uniform(-2, 2, (30, 3)))

    def linear(x, index):
        error = np.einsum("nkf,nf->nk", matrix[index], x) - target[index]
        return squares(error, matrix[index])

    start, low, high = (np.full((30, 3), v) for v in (0.0, -0.5, 0.5))
    found = minimise(linear, start, low, high, settled=1e-9, evaluations=200)
    assert found.converged.all()
    for n in range(30):
        best = lsq_linear(matrix[n], target[n], (low[n], high[n]), method="bvls").cost
        assert found.expansion.loss[n] == pytest.approx(best, rel=1e-4, abs=1e-6)


def quadratics(curvature, slope):
    """Quadratics (N,) about 0 with these curvatures (N, F, F) and slopes (N, F)."""

    def at(x, index):
        bend = np.einsum("nfg,ng->nf", curvature[index], x)
        loss = np.einsum("nf,nf->n", slope[index] + 0.5 * bend, x)
        return Expansion(loss, slope[index] + bend, curvature[index].copy(), {})

    return at


def test_rounding_at_a_bound_ends_the_search():
    """x + (high - x) may lie beyond the bound, by an amount that no damping shrinks."""
    rng = np.random.default_rng(0)
    start, high = np.sort(rng.uniform(0.05, 0.95, (2, 4000)), axis=0)[..., None]
    assert (start + (high - start) > high).any()
    falling = quadratics(np.full((4000, 1, 1), 1e-3), np.full((4000, 1), -1.0))
    found = minimise(falling, start, np.zeros_like(high), high, settled=1e-12)
    assert (found.x <= high).all()
    np.testing.assert_allclose(found.x, high, rtol=1e-12)


scales = st.floats(-150, 150).map(lambda power: 10.0**power)
numbers = st.one_of(
    st.just(0.0), st.builds(lambda x, sign: sign * x, scales, st.sampled_from((-1, 1)))
)


@settings(max_examples=300, deadline=None)
@given(st.integers(1, 4), st.data())
def test_every_search_ends_within_its_bounds(size, data):
    """Curvatures and slopes of any sign and scale, singular, indefinite; a start outside, too."""
    draw = arrays(float, (2, size, size), elements=numbers)
    factor = data.draw(draw)
    curvature = np.einsum("nfk,ngk->nfg", factor, factor)
    if data.draw(st.booleans()):
        curvature = 0.5 * (factor + factor.swapaxes(1, 2))
    slope = data.draw(arrays(float, (2, size), elements=numbers))
    reach = data.draw(arrays(float, (2, size), elements=st.floats(0, 1e3)))
    with np.errstate(all="ignore"):
        start = data.draw(st.sampled_from((0.3, 5.0))) * reach
        found = minimise(quadratics(curvature, slope), start, -reach, reach)
    assert (np.abs(found.x) <= reach).all()


def test_places_without_a_parameter_stay():
    free = np.array([[True, False]] * 3)
    found = minimise(expand, START, LOW, HIGH, free=free, settled=1e-10)
    np.testing.assert_array_equal(found.x[:, 1], 1.0)
    wave = np.exp(-T)
    best = [wave @ noisy(n) / (wave @ wave) for n in range(3)]
    np.testing.assert_allclose(found.x[:, 0], best, rtol=1e-6)


def test_what_ran_out_of_evaluations_has_not_converged():
    assert not minimise(expand, START, LOW, HIGH, evaluations=2, settled=1e-10).converged.any()


def test_soft_loss_is_the_sum_of_squares_of_small_residuals():
    error = 1e-3 * np.random.default_rng(0).standard_normal(100)
    assert robust_loss(error, 1.0) == pytest.approx(np.sum(error**2), rel=1e-5)
    assert robust_loss(np.array([100.0]), 1.0) == pytest.approx(2 * (np.sqrt(1e4 + 1) - 1))


@pytest.mark.parametrize("wild", [0.0, 0.05])
def test_robust_scale_ignores_a_few_wild_samples(wild):
    rng = np.random.default_rng(0)
    error = 0.002 * rng.standard_normal(20000)
    error[: int(wild * error.size)] = 1.0
    assert robust_scale(error) == pytest.approx(0.002, rel=0.02 if wild == 0 else 0.4)


def test_a_hopeless_problem_is_given_up_and_the_others_end_as_without_it():
    start, low, high = np.full((3, 2), 0.3), np.zeros((3, 2)), np.full((3, 2), 9.0)
    asked = []

    def hopeless(places, points, losses, promised):
        asked.append(places)
        assert points.shape == start.shape and np.isfinite(losses).all()
        assert promised.shape == places.shape and (promised > 0).all()
        return places == 1

    whole = minimise(expand, start, low, high, settled=1e-9)
    some = minimise(expand, start, low, high, settled=1e-9, hopeless=hopeless)
    assert asked and all(1 not in places for places in asked[1:])
    assert not some.converged[1] and some.converged[[0, 2]].all()
    assert some.expansion.loss[1] > whole.expansion.loss[1]
    np.testing.assert_array_equal(some.x[[0, 2]], whole.x[[0, 2]])


def test_losses_that_come_first_lead_to_the_same_minimum_with_fewer_expansions():
    start, low, high = np.full((3, 2), 0.3), np.zeros((3, 2)), np.full((3, 2), 9.0)
    expanded = []

    def counted(x, index):
        expanded.append(index.size)
        return expand(x, index)

    def losses(x, index):
        return expand(x, index).loss

    whole = minimise(counted, start, low, high, settled=1e-9)
    every, expanded[:] = sum(expanded), []
    cheap = minimise(counted, start, low, high, settled=1e-9, losses=losses)
    np.testing.assert_array_equal(cheap.x, whole.x)
    np.testing.assert_array_equal(cheap.expansion.curvature, whole.expansion.curvature)
    assert sum(expanded) < every


def test_searches_that_follow_a_better_one_or_stay_behind_cannot_win():
    points = np.array([[0.0, 0.0], [0.05, 0.0], [3.0, 0.0], [5.0, 0.0]])
    losses = np.array([10.0, 11.0, 35.0, 80.0])
    active = np.arange(4)
    few = cannot_win(active, points, losses, np.zeros(4))
    np.testing.assert_array_equal(few, [False, True, False, True])
    promised = np.array([0.0, 0.0, 0.0, 10.0])  # the last may still come within reach
    more = cannot_win(active, points, losses, promised)
    np.testing.assert_array_equal(more, [False, True, False, False])


def test_the_error_is_that_of_all_samples_together():
    assert rms([np.array([3.0]), np.array([4.0, 0.0])]) == pytest.approx(np.sqrt(25 / 3))
    assert rms([]) == 0.0


def test_a_parameter_says_its_prior_and_its_unit():
    assert (
        str(Parameter("kp_Nm_per_rad", 0.5, 8.0, 2.0, log=True)) == "log-uniform 0.5 to 8 N m/rad"
    )
    assert str(Parameter("latency_s", 0.0, 0.5, 0.05)) == "uniform 0 to 0.5 s"
    assert str(Parameter("u_m_s", -1, 1, 0.1, 0.02, 0.3)) == "normal 0.02 ± 0.3 m/s"
    assert Parameter("kp_Nm_per_rad", 1, 2, 1, unit="1/s²").unit == "1/s²"
