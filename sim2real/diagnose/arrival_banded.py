"""Normal equations of many short responses: banded, since only neighbours overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.arrival_noise import Stretch, whiten

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NEGLIGIBLE = 1e-5
"""Share of the squares of all responses that may be left where they are cut off."""


@dataclass(frozen=True)
class Normal:
    """Inner products of whitened responses and of what they are to explain.

    Set-points of all recordings stand one after another.

    Attributes:
        gram: Of the responses; row d holds those of set-points k and k + d, shape (W, K).
        cross: Of the responses with the residual and the columns of ``Response.refit``, (K, 4).
        square: Of the latter among themselves, shape (4, 4).
    """

    gram: Array
    cross: Array
    square: Array

    def plus(self, other: Normal, weight: float) -> Normal:
        """The sum with ``weight`` times another."""
        return Normal(
            self.gram + weight * other.gram,
            self.cross + weight * other.cross,
            self.square + weight * other.square,
        )

    def times(self, amount: Array) -> Array:
        """Product of ``gram`` and a vector (K,)."""
        out = self.gram[0] * amount
        for d in range(1, min(len(self.gram), amount.size)):
            band = self.gram[d, :-d]
            out[d:] += band * amount[:-d]
            out[:-d] += band * amount[d:]
        return np.asarray(out)


def normals(
    stretches: Sequence[Stretch], tables: Sequence[Array], autoregression: Array
) -> tuple[Normal, Normal]:
    """Normal equations of the samples in motion and of those at rest.

    Args:
        stretches: The recordings of one joint.
        tables: For each its responses, laid out as in ``Response``, shape (K, W).
        autoregression: Coefficients, shape (p,).
    """
    white = _cut([_whiten_table(table, autoregression) for table in tables])
    columns = [
        whiten(np.column_stack([s.residual, s.response.refit]), autoregression) for s in stretches
    ]
    moving, rest = (
        _joined(
            [
                _normal(table, x, s.counts & (s.rests == resting), s.response.first)
                for table, x, s in zip(white, columns, stretches, strict=True)
            ]
        )
        for resting in (False, True)
    )
    return moving, rest


def _whiten_table(table: Array, autoregression: Array) -> Array:
    """Innovations of responses (K, W), each 0 before and after, shape (K, W + p)."""
    W, p = table.shape[1], autoregression.size
    filtering = np.zeros((W, W + p))
    for m in range(W):
        filtering[m, m : m + p + 1] = np.concatenate([[1.0], -autoregression])
    return np.asarray(table @ filtering)


def _cut(tables: Sequence[Array]) -> list[Array]:
    """The tables with as many columns as matter, the same number for all."""
    longest = max(table.shape[1] for table in tables)
    wide = [np.pad(table, ((0, 0), (0, longest - table.shape[1]))) for table in tables]
    after = np.cumsum(sum(np.sum(table**2, axis=0) for table in wide)[::-1])[::-1]
    kept = max(int(np.sum(after > NEGLIGIBLE * after[0])), 1)
    return [table[:, :kept] for table in wide]


def _normal(table: Array, columns: Array, part: Mask, first: int) -> Normal:
    K, W = table.shape
    if not part.any():
        return Normal(np.zeros((W, K)), np.zeros((K, 4)), np.zeros((4, 4)))
    padded = np.zeros((K + first + W, 5))
    padded[:K, :4] = columns * part[:, None]
    padded[:K, 4] = part
    cut = np.empty_like(table)
    cross = np.zeros((K, 4))
    for m in range(W):
        there = padded[first + m : first + m + K]
        cut[:, m] = table[:, m] * there[:, 4]
        cross += cut[:, m, None] * there[:, :4]
    gram = np.zeros((W, K))
    for d in range(min(W, K)):
        gram[d, : K - d] = np.einsum("km,km->k", cut[: K - d, d:], cut[d:, : W - d])
    return Normal(gram, cross, padded[:, :4].T @ padded[:, :4])


def _joined(parts: Sequence[Normal]) -> Normal:
    return Normal(
        np.concatenate([x.gram for x in parts], axis=1),
        np.concatenate([x.cross for x in parts]),
        np.asarray(sum(x.square for x in parts)),
    )
