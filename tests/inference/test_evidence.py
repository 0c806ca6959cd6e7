"""Evidence against integrals that are known."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sim2real.inference.evidence import log_evidence, occam_factor, probabilities

RNG = np.random.default_rng(3)
A = RNG.standard_normal((30, 3))
PRIOR = np.diag([1.0, 4.0, 0.25])
Y = A @ [0.5, -1.0, 0.2] + RNG.standard_normal(30)


def exact(columns):
    """Log-evidence of a linear model with unit noise, its constant left out."""
    B, prior = A[:, columns], PRIOR[np.ix_(columns, columns)]
    whole = multivariate_normal(np.zeros(30), np.eye(30) + B @ prior @ B.T).logpdf(Y)
    return whole + 15 * np.log(2 * np.pi)


@pytest.mark.parametrize("columns", [[0], [0, 1], [0, 1, 2]])
def test_laplace_is_exact_for_a_linear_model(columns):
    B, prior = A[:, columns], PRIOR[np.ix_(columns, columns)]
    curvature = B.T @ B + np.linalg.inv(prior)
    best = np.linalg.solve(curvature, B.T @ Y)
    loss = 0.5 * np.sum((Y - B @ best) ** 2) + 0.5 * best @ np.linalg.inv(prior) @ best
    assert log_evidence(loss, curvature, prior) == pytest.approx(exact(columns), rel=1e-9)


def test_occam_counts_what_nuisances_leave():
    information = A.T @ A
    left = information[2, 2] - information[2, :2] @ np.linalg.solve(
        information[:2, :2], information[:2, 2]
    )
    found = occam_factor(information[None], 2.0, nuisance=2)[0]
    assert found == pytest.approx(0.5 * np.log(1 + 4 * left))
    assert occam_factor(information[None], 2.0, nuisance=3)[0] == 0.0


def test_probabilities_add_up_however_far_apart():
    found = probabilities(np.array([0.0, -1.0, 2000.0]))
    assert found.sum() == pytest.approx(1.0)
    assert found[2] == pytest.approx(1.0)
