"""A Markov chain in a file, which continues with identical results, and how well it has mixed."""

import hashlib
import io
import math
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from glob import escape
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.inference.correlated_noise import autocorrelation_times
from sim2real.output import beside, is_stream, write_whole
from sim2real.structured import read_arrays

LogDensity = Callable[[Array], Array]

FORMAT = "sim2real.chain/1"
LEAST_TIMES = 50
"""Smallest length of a chain, in autocorrelation times, for its samples to be used."""
BURN_IN_TIMES = 5
"""Number of initial steps to discard, in autocorrelation times."""


def chain_file(out: Path, joint: str) -> Path | None:
    """File of the chain of a joint, next to the result ``out``; None next to a device or a pipe."""
    return None if is_stream(out) else beside(out, f"{out.stem}.chain.{joint}.npz")


def clear_leftovers(file: Path) -> None:
    """Remove temporary files of a process that was killed while writing ``file``."""
    for leftover in file.parent.glob(f".{escape(file.name)}.*"):
        leftover.unlink(missing_ok=True)


@dataclass(frozen=True)
class Chain:
    """An ensemble of walkers after N steps."""

    coordinates: Array  # standardised coordinates, shape (N, W, F)
    log_density: Array  # log-posterior at these, shape (N, W)
    accepted: NDArray[np.int64]  # number of accepted moves of each walker, shape (W,)
    random: tuple[Any, ...]  # state of the random number generator, from ``RandomState.get_state``
    # constant arrays by name that define the coordinates, and the initial walkers
    origin: Mapping[str, Array]
    fingerprint: str  # hash of the problem; a chain is continued only for the same problem

    @property
    def steps(self) -> int:
        """Number of completed steps."""
        return int(self.coordinates.shape[0])

    @property
    def acceptance(self) -> float:
        """Share of the moves that were accepted, all walkers together."""
        return float(self.accepted.sum() / max(self.steps * self.accepted.size, 1))

    @cached_property
    def times(self) -> Array:
        """Integrated autocorrelation time of each parameter in steps, shape (F,)."""
        return autocorrelation_times(self.coordinates)

    @property
    def spans(self) -> float:
        """Length in units of the longest autocorrelation time."""
        return float(self.steps / self.times.max())

    @property
    def reached(self) -> bool:
        """Whether it is long enough."""
        return self.spans >= LEAST_TIMES

    @property
    def needed(self) -> int:
        """Number of steps that is enough in nearly all cases.

        The autocorrelation time of a short chain is estimated too small, by a factor of at most
        ``1.2 + 700 / spans**2`` in 98 % of autoregressive chains of 8 to 32 walkers; it is taken to
        be no longer than the chain.
        """
        if self.reached:
            return self.steps
        margin = 1.2 + 700 / self.spans**2
        least = LEAST_TIMES * min(margin * float(self.times.max()), 1.2 * self.steps)
        return max(math.ceil(least), self.steps + 1)

    @property
    def burn_in(self) -> int:
        """Number of initial steps to discard."""
        return min(math.ceil(BURN_IN_TIMES * float(self.times.max())), self.steps // 2)

    @property
    def thin(self) -> int:
        """Number of steps between samples that are kept."""
        return max(1, int(self.times.min() / 2))

    def sample(self) -> Array:
        """Thinned samples after the burn-in, standardised coordinates of shape (N, F)."""
        kept = self.coordinates[self.burn_in :: self.thin]
        return np.asarray(kept.reshape(-1, kept.shape[2]))


def new_chain(
    walkers: int, free: int, seed: int, origin: Mapping[str, Array], fingerprint: str
) -> Chain:
    """A chain without steps, whose walkers start from a standard normal distribution.

    That is the Laplace approximation in standardised coordinates.
    """
    random = np.random.RandomState(seed)  # noqa: NPY002 - the generator that emcee requires
    origin = {**origin, "start": random.normal(size=(walkers, free))}
    none, state = np.empty((0, walkers, free)), tuple(random.get_state(legacy=True))
    accepted = np.zeros(walkers, dtype=np.int64)
    return Chain(none, none[:, :, 0], accepted, state, origin, fingerprint)


def run_chain(
    chain: Chain,
    log_density: LogDensity,
    steps: int,
    file: Path | None = None,
    progress: Callable[[int], None] = lambda steps: None,
    *,
    spans: float = math.inf,
) -> Chain:
    """Continue a chain to ``steps`` steps in all, writing it to ``file`` after every block.

    It ends before that where it is ``spans`` times as long as its longest autocorrelation time.

    ``log_density`` is that of standardised coordinates (B, F), shape (B,). A block is a tenth of
    the previous steps, so that the total cost of writing grows only in proportion to the length of
    the chain; after each, ``progress`` is called with the number of completed steps.

    Raises:
        InputError: If the file can't be written.
    """
    from emcee import EnsembleSampler, State  # type: ignore[import-untyped]

    W, F = chain.coordinates.shape[1:]
    sampler = EnsembleSampler(W, F, log_density, moves=_moves(), vectorize=True)
    sampler.log_prob_fn = log_density  # the wrapper of emcee prints a traceback of every interrupt
    start, density = chain.origin["start"], None
    if chain.steps:
        start, density = chain.coordinates[-1], chain.log_density[-1]
    state = State(start, density, random_state=chain.random)
    while chain.steps < steps and (not chain.steps or chain.spans < spans):
        block = min(max(100, int(0.1 * chain.steps)), steps - chain.steps)
        sampler.reset()
        state = deque(interruptible(sampler.sample(state, iterations=block)), maxlen=1).pop()
        chain = replace(
            chain,
            coordinates=np.concatenate([chain.coordinates, sampler.get_chain()]),
            log_density=np.concatenate([chain.log_density, sampler.get_log_prob()]),
            accepted=chain.accepted + sampler.backend.accepted.astype(np.int64),
            random=state.random_state,
        )
        if file is not None:
            write_chain(chain, file)
        progress(chain.steps)
    return chain


def interruptible(items: Iterable[Any]) -> Iterator[Any]:
    """The items; an interrupt ends them even where it falls into a destructor, which ignores it."""
    if threading.current_thread() is not threading.main_thread():
        yield from items
        return
    before, interrupted = signal.getsignal(signal.SIGINT), False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        if callable(before):
            before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        for item in items:
            yield item
            if interrupted:
                raise KeyboardInterrupt
    finally:
        signal.signal(signal.SIGINT, before)


def write_chain(chain: Chain, file: Path) -> None:
    """Write a chain whole, without pickle; InputError if the file can't be written."""
    _, keys, *numbers = chain.random
    arrays = {
        "format": np.array(FORMAT),
        "fingerprint": np.array(chain.fingerprint),
        "coordinates": chain.coordinates,
        "log_density": chain.log_density,
        "accepted": chain.accepted,
        "random_keys": keys,
        "random_numbers": np.array(numbers, dtype=np.float64),
        **{f"origin.{name}": value for name, value in chain.origin.items()},
    }
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, checksum=np.array(_checksum(arrays)), **arrays)
    write_whole(file, stream.getvalue())


def read_chain(file: Path) -> Chain:
    """Read a chain; InputError if the file is not one, or is damaged."""
    arrays = read_arrays(file, "a chain, or no such file", what="chain")
    checksum = arrays.pop("checksum", None)
    if str(arrays.get("format")) != FORMAT or str(checksum) != _checksum(arrays):
        raise InputError(file, "", "no chain, or a damaged one", "a chain, or no such file")
    position, has_gauss, gauss = arrays["random_numbers"]
    return Chain(
        coordinates=arrays["coordinates"],
        log_density=arrays["log_density"],
        accepted=arrays["accepted"],
        random=("MT19937", arrays["random_keys"], int(position), int(has_gauss), float(gauss)),
        origin={
            name.removeprefix("origin."): value
            for name, value in arrays.items()
            if name.startswith("origin.")
        },
        fingerprint=str(arrays["fingerprint"]),
    )


def _checksum(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of the names, shapes and values of arrays."""
    digest = hashlib.sha256()
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _moves(*, freedom: float = 5.0, scale: float = 1.1) -> list[tuple[Any, float]]:
    """Moves of ``emcee`` for standardised coordinates, each with its share of the steps.

    Where the posterior is nearly normal, independent proposals about the optimum (from a Student
    distribution with few degrees of ``freedom``, hence heavy tails) are mostly accepted, and
    samples are nearly uncorrelated; elsewhere the moves that adapt to the ensemble are more
    efficient. Sources: Tierney, Annals of Statistics 22 (1994) 1701-1728 (independence chains,
    mixtures of moves); Goodman and Weare, Communications in Applied Mathematics and Computational
    Science 5 (2010) 65-80; ter Braak, Statistics and Computing 16 (2006) 239-249.
    """
    from emcee.moves import DEMove, MHMove, StretchMove  # type: ignore[import-untyped]

    def log_student(w: Array) -> Array:
        square = np.sum((w / scale) ** 2, axis=1)
        return np.asarray(-0.5 * (freedom + w.shape[1]) * np.log1p(square / freedom))

    def independent(w: Array, random: Any) -> tuple[Array, Array]:  # noqa: ANN401 - emcee's
        tail = np.sqrt(random.chisquare(freedom, size=(len(w), 1)) / freedom)
        new = scale * random.normal(size=w.shape) / tail
        return new, log_student(w) - log_student(new)

    return list(zip((MHMove(independent), StretchMove(), DEMove()), (0.6, 0.2, 0.2), strict=True))


def require(chain: Chain, what: str, names: tuple[str, ...]) -> None:
    """Raise an InputError with a number of steps, unless a chain is long enough."""
    if chain.reached:
        return
    steps = math.ceil(chain.needed / 500) * 500
    raise InputError(
        what,
        names[int(chain.times.argmax())],
        f"{chain.steps} steps, {chain.spans:.0f} of its autocorrelation times",
        f"at least {LEAST_TIMES}; run again with --steps {steps}: the chain continues",
    )
