"""Terms of the log-evidence of a fit: profile likelihood, Occam factor, expected chance gain."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def profile_loglikelihood(error2: Array, count: Array) -> Array:
    """-n/2 log(error2 / n): that of normal errors, their variance at its best, up to 1."""
    return np.asarray(-0.5 * count * np.log(np.maximum(error2, 1e-300) / np.maximum(count, 1)))


def occam_factor(information: Array, prior_sd: float, nuisance: int = 0) -> Array:
    """What parameters cost that the likelihood alone does not count, shape (N,).

    1/2 log det(1 + prior variance x information), the information being what the nuisance
    parameters leave of it. Source: MacKay, Information Theory, Inference, and Learning Algorithms
    (Cambridge, 2003), ch. 28.

    Args:
        information: Second derivatives of minus the log-likelihood, in natural units, shape
            (N, F, F).
        prior_sd: Prior standard deviation of each parameter in natural units.
        nuisance: The first so many are in every model alike, and cost nothing.
    """
    base, normal = information[:, :nuisance, :nuisance], information[:, nuisance:, nuisance:]
    if not normal.shape[1]:
        return np.zeros(len(information))
    across = information[:, :nuisance, nuisance:]
    inverse = np.linalg.pinv(base, rcond=1e-10, hermitian=True)
    left = normal - np.einsum("nfa,nfg,ngb->nab", across, inverse, across)
    matrix = np.eye(left.shape[1]) + prior_sd**2 * left
    return np.asarray(0.5 * np.linalg.slogdet(matrix)[1])


def chance_gain(parameters: int, count: float) -> float:
    """Log-likelihood that parameters gain by chance: Schwarz, Ann. Stat. 6 (1978) 461."""
    return 0.5 * parameters * float(np.log(count))


def student(score2: ArrayLike, known: float) -> Array:
    """Log odds of a change of unknown size against none, without the prior.

    The score follows Student's law where there is no change; Laplace's integral over the size.

    Args:
        score2: Squared scores, of any shape.
        known: Unchanged recordings that they are relative to.
    """
    more = 0.5 * (known + 1) * np.log1p(np.asarray(score2) / known)
    return np.asarray(more - 0.5 * np.log1p(score2))
