"""Terms of the log-evidence of a fit."""

import numpy as np
from numpy.typing import ArrayLike

from sim2real.arrays import Array


def profile_loglikelihood(error2: Array, count: Array) -> Array:
    """Log-likelihood of normal errors with fitted variance, -n/2 log(error2 / n)."""
    return np.asarray(-0.5 * count * np.log(np.maximum(error2, 1e-300) / np.maximum(count, 1)))


def occam_factor(information: Array, prior_sd: float, nuisance: int = 0) -> Array:
    """Penalty of the evidence for free parameters, shape (N,).

    1/2 log det(1 + prior variance x information), with the information (N, F, F) in natural units
    after elimination of the leading ``nuisance`` parameters, which all models share. Source:
    MacKay, Information Theory, Inference, and Learning Algorithms (Cambridge, 2003), ch. 28.
    """
    base, normal = information[:, :nuisance, :nuisance], information[:, nuisance:, nuisance:]
    if not normal.shape[1]:
        return np.zeros(len(information))
    cross = information[:, :nuisance, nuisance:]
    inverse = np.linalg.pinv(base, rcond=1e-10, hermitian=True)
    marginal = normal - np.einsum("nfa,nfg,ngb->nab", cross, inverse, cross)
    matrix = np.eye(marginal.shape[1]) + prior_sd**2 * marginal
    return np.asarray(0.5 * np.linalg.slogdet(matrix)[1])


def student(score2: ArrayLike, references: float) -> Array:
    """Log odds of a change by squared scores, which else are Student's t over ``references``."""
    gain = 0.5 * (references + 1) * np.log1p(np.asarray(score2) / references)
    return np.asarray(gain - 0.5 * np.log1p(score2))
