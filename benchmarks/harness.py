"""What benchmarks share: options, processes of one thread, lines of JSON that are kept, tables."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

for _library in ("OMP", "OPENBLAS", "MKL"):  # read where a process loads them
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
REAL = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
"""Folder of real recordings."""
Job = TypeVar("Job")
Row = TypeVar("Row")
_ADDITIONS = 10_000_000


def command_line(doc: str | None, *paths: str, **others: Any) -> argparse.ArgumentParser:  # noqa: ANN401
    """A parser whose description is the first line of ``doc``.

    Args:
        doc: The script's docstring.
        paths: Names of files and folders that must be given, in order.
        others: The options and their defaults, which have their types: ``cell_m=0.01`` is
            ``--cell-m``. A list takes any number of values, False is a flag, and a type stands for
            an option without a default. A tuple has the default and what ``--help`` says of it.
    """
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    for name in paths:
        parser.add_argument(name, type=Path)
    for name, value in others.items():
        default, told = value if isinstance(value, tuple) else (value, None)
        flag = "--" + name.replace("_", "-")
        if default is False:
            parser.add_argument(flag, action="store_true", help=told)
        elif isinstance(default, type):
            parser.add_argument(flag, type=default, help=told)
        elif isinstance(default, list):
            kind = type(default[0])
            parser.add_argument(flag, type=kind, nargs="*", default=default, help=told)
        else:
            parser.add_argument(flag, type=type(default), default=default, help=told)
    return parser


def spread(
    work: Callable[[Job], Row],
    jobs: Sequence[Job],
    processes: int,
    *,
    unit: str = "case",
    in_order: bool = True,
    seconds: float = float("inf"),
) -> Iterator[Row]:
    """Results of ``work`` for each job, so many at a time, each process with one thread.

    Args:
        work: A function of a module, as new processes import it.
        jobs: Its arguments.
        processes: Number of processes.
        unit: What the progress counts.
        in_order: Whether results come in the order of their jobs, or as they end.
        seconds: Time after which no further job is started.
    """
    end = time.monotonic() + seconds
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        running = [pool.submit(work, job) for job in jobs]
        ended = running if in_order else as_completed(running)
        try:
            for one in tqdm(ended, total=len(running), unit=unit, disable=None):
                if time.monotonic() > end:
                    for other in running:
                        other.cancel()
                if not one.cancelled():
                    yield one.result()
        finally:
            pool.shutdown(cancel_futures=True)


def read_lines(path: Path) -> list[Any]:
    """The rows of a file of JSON lines, none where there is no file; a line cut off is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def kept(path: Path, rows: Iterable[Row]) -> Iterator[Row]:
    """The rows, each appended to a file as a line of JSON before the next is waited for."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        for row in rows:
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield row


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def real_recordings() -> Path:
    """The folder of real recordings; the script ends where there is none."""
    if not REAL.is_dir():
        raise SystemExit(f"no real recordings in {REAL}; set SIM2REAL_REALDATA")
    return REAL


def seconds_per_ten_million_additions(repeats: int = 3) -> float:
    """Seconds that ten million additions in a Python loop take: a unit for times.

    The least of some tries is what an idle machine takes: other programs only add to it.
    """
    return min(_additions() for _ in range(repeats))


def _additions() -> float:
    """The loop as a script has it, its variables global."""
    loop = compile(
        f"total = 0\nfor number in range({_ADDITIONS}): total = total + number", "", "exec"
    )
    start = time.perf_counter()
    exec(loop, {})
    return time.perf_counter() - start
