"""A Markov chain that lives in a file: killed at any moment, it goes on as if it had not been."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.output import write_whole

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]

FORMAT = "sim2real.chain/1"
SMALLEST_BLOCK, BLOCK_SHARE = 100, 0.1
"""Steps of a block: at least so many, and this share of all before it, so that writing stays cheap
however long the chain."""


def chain_file(out: Path, joint: str) -> Path:
    """Where the chain of a joint is kept, next to the result ``out``."""
    return out.with_name(f"{out.stem}.chain.{joint}.npz")


@dataclass(frozen=True)
class Chain:
    """An ensemble of walkers after N steps.

    Attributes:
        coordinates: Where they were, standardised, shape (N, W, F).
        log_density: Log-posterior there, shape (N, W).
        accepted: Moves accepted by each walker, shape (W,).
        random: State of the random numbers, as ``RandomState.get_state`` gives it.
        origin: What the chain is about: arrays by name, the same from the first step to the last.
        fingerprint: Of the problem; a chain goes on only with its own.
    """

    coordinates: Array
    log_density: Array
    accepted: NDArray[np.int64]
    random: tuple[Any, ...]
    origin: Mapping[str, Array]
    fingerprint: str

    @property
    def steps(self) -> int:
        """Steps made."""
        return int(self.coordinates.shape[0])


def new_chain(
    walkers: int, free: int, seed: int, origin: Mapping[str, Array], fingerprint: str
) -> Chain:
    """A chain of no steps yet.

    Its walkers start from a standard normal distribution, which is the Laplace approximation in
    standardised coordinates.
    """
    random = np.random.RandomState(seed)  # noqa: NPY002 - the generator that emcee takes
    start = random.normal(size=(walkers, free))
    given = {**origin, "start": start}
    empty = np.empty((0, walkers))
    return Chain(
        coordinates=np.empty((0, walkers, free)),
        log_density=empty,
        accepted=np.zeros(walkers, dtype=np.int64),
        random=tuple(random.get_state(legacy=True)),
        origin=given,
        fingerprint=fingerprint,
    )


def run_chain(
    chain: Chain,
    log_density: LogDensity,
    steps: int,
    file: Path | None = None,
    progress: Callable[[int], None] = lambda steps: None,
) -> Chain:
    """Go on until the chain has ``steps`` steps, writing it to ``file`` after every block.

    Args:
        chain: Where to start from.
        log_density: Log-posterior of standardised coordinates (B, F), shape (B,).
        steps: Steps that it shall have.
        file: Where it lives, if anywhere.
        progress: Called with the steps made, after every block.

    Raises:
        InputError: If the file can't be written.
    """
    from emcee import EnsembleSampler, State  # type: ignore[import-untyped]

    W, F = chain.coordinates.shape[1:]
    sampler = EnsembleSampler(W, F, log_density, moves=moves(F), vectorize=True)
    blocks = [chain.coordinates], [chain.log_density]
    accepted = chain.accepted.copy()
    made = chain.steps
    if made:
        state = State(chain.coordinates[-1], chain.log_density[-1], random_state=chain.random)
    else:
        state = State(chain.origin["start"], random_state=chain.random)
    while made < steps:
        block = min(max(SMALLEST_BLOCK, int(BLOCK_SHARE * made)), steps - made)
        coordinates, log_posterior = np.empty((block, W, F)), np.empty((block, W))
        before = state.coords.copy()
        for k, new in enumerate(sampler.sample(state, iterations=block, store=False)):
            coordinates[k], log_posterior[k] = new.coords, new.log_prob
            accepted += np.any(new.coords != before, axis=1)
            before = new.coords.copy()
            state = new
        made += block
        blocks[0].append(coordinates)
        blocks[1].append(log_posterior)
        chain = Chain(
            coordinates=np.concatenate(blocks[0]),
            log_density=np.concatenate(blocks[1]),
            accepted=accepted.copy(),
            random=state.random_state,
            origin=chain.origin,
            fingerprint=chain.fingerprint,
        )
        if file is not None:
            write_chain(chain, file)
        progress(made)
    return chain


def write_chain(chain: Chain, file: Path) -> None:
    """Write a chain, whole or not at all; without pickle.

    Raises:
        InputError: If the file can't be written.
    """
    kind, keys, *numbers = chain.random
    if kind != "MT19937":
        raise ValueError(f"random numbers of {kind}, not of MT19937")
    stream = io.BytesIO()
    given = {f"origin.{name}": value for name, value in chain.origin.items()}
    np.savez(
        stream,
        allow_pickle=False,
        format=np.array(FORMAT),
        fingerprint=np.array(chain.fingerprint),
        coordinates=chain.coordinates,
        log_density=chain.log_density,
        accepted=chain.accepted,
        random_keys=keys,
        random_numbers=np.array(numbers, dtype=np.float64),
        **given,  # type: ignore[arg-type]
    )
    write_whole(file, stream.getvalue())


def clear_leftovers(file: Path) -> None:
    """Remove what a process that was killed while it wrote ``file`` has left beside it."""
    for leftover in file.parent.glob(f".{escape(file.name)}.*"):
        leftover.unlink(missing_ok=True)


def read_chain(file: Path) -> Chain:
    """Read a chain.

    Raises:
        InputError: If the file is no chain.
    """
    try:
        with np.load(file, allow_pickle=False) as content:
            given = {name: content[name] for name in content.files}
        if str(given["format"]) != FORMAT:
            raise InputError(file, "format", str(given["format"]), FORMAT)
        position, has_gauss, gauss = given["random_numbers"]
        return Chain(
            coordinates=given["coordinates"],
            log_density=given["log_density"],
            accepted=given["accepted"],
            random=("MT19937", given["random_keys"], int(position), int(has_gauss), float(gauss)),
            origin={
                name.removeprefix("origin."): value
                for name, value in given.items()
                if name.startswith("origin.")
            },
            fingerprint=str(given["fingerprint"]),
        )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        reason = f"{type(error).__name__}: {error}"
        raise InputError(file, "", f"no chain ({reason})", "a chain, or no such file") from None


FREEDOM, SCALE = 5.0, 1.1
"""Degrees of freedom and size of the proposals: heavier tails than any normal distribution."""
SHARES = (0.6, 0.2, 0.2)
"""Share of steps that are independent proposals, stretch moves, and differences of walkers."""


def moves(free: int) -> list[tuple[Any, float]]:
    """Moves of ``emcee`` for F standardised coordinates, each with its share of the steps.

    Where the posterior is nearly normal an independent proposal from the Laplace approximation is
    mostly accepted and forgets where it came from; where it is not, the moves that follow the
    ensemble itself take over. Sources: Tierney, Annals of Statistics 22 (1994) 1701-1728
    (independence chains, mixtures of moves); Goodman and Weare, Communications in Applied
    Mathematics and Computational Science 5 (2010) 65-80; ter Braak, Statistics and Computing 16
    (2006) 239-249.
    """
    from emcee.moves import DEMove, MHMove, StretchMove  # type: ignore[import-untyped]

    each = (MHMove(independent, ndim=free), StretchMove(), DEMove())
    return list(zip(each, SHARES, strict=True))


def independent(
    coordinates: Array,
    random: np.random.RandomState,  # noqa: NPY002 - the generator that emcee has
) -> tuple[Array, Array]:
    """New coordinates (W, F) from a Student distribution about the optimum, and their log-ratio."""
    W, F = coordinates.shape
    tail = np.sqrt(random.chisquare(FREEDOM, size=(W, 1)) / FREEDOM)
    new = SCALE * random.normal(size=(W, F)) / tail
    return new, _log_student(coordinates) - _log_student(new)


def _log_student(w: Array) -> Array:
    square = np.sum((w / SCALE) ** 2, axis=1)
    return np.asarray(-0.5 * (FREEDOM + w.shape[1]) * np.log1p(square / FREEDOM))
