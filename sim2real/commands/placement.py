"""Options of commands that say where their jobs run."""

from __future__ import annotations

import argparse
from typing import Any

from sim2real.commands.command import add_number


def add_executor(
    command: argparse.ArgumentParser, *, default: str | None = None, otherwise: str = ""
) -> None:
    """Add ``--executor``, ``--jobs``, ``--address`` and ``--retries``.

    Args:
        command: The parser to add to.
        default: The executor without the option; None for no jobs.
        otherwise: What happens without the option.
    """
    command.add_argument(
        "--executor",
        choices=("local", "ray"),
        default=default,
        help="one process per run, on this machine or on a Ray cluster"
        f" (default: {otherwise or default})",
    )
    command.add_argument(
        "--jobs", type=int, metavar="N", help="runs at the same time (default: one per GPU)"
    )
    command.add_argument(
        "--address", help="address of the Ray cluster, HOST:PORT (default: a local one)"
    )
    add_number(command, "--retries", "RETRIES", "times that a failed run is repeated", 2)


def where_jobs_run(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of ``run_jobs`` from these options; a job on a device other than cpu has a GPU."""
    return {
        "executor": options.executor,
        "at_once": options.jobs,
        "address": options.address,
        "gpus": 0 if getattr(options, "device", "cpu") == "cpu" else 1,
        "retries": options.retries,
    }
