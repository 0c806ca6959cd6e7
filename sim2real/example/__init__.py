"""Recordings that come with the library: three servos on a bench, and a swim of a robot.

They are simulated, not measured, by programs that share no code with the library
(``datasets/servo_steps`` and ``datasets/pool`` of the repository).
"""

import os
from pathlib import Path

from sim2real.errors import InputError
from sim2real.output import check_writable, write_whole

BENCH = Path(__file__).parent / "bench"
"""Folder of ``steps.csv``, ``square.csv`` and ``chirp.csv`` with their ``robot.toml``."""
POOL = Path(__file__).parent / "pool"
"""Folder of the swim ``p1.csv`` with its ``robot.toml`` and the ``model.json`` of its servos."""


def copy_example(folder: str | os.PathLike[str]) -> list[Path]:
    """Copy the recordings into ``folder / "bench"`` and ``folder / "pool"``.

    Returns:
        The files written.

    Raises:
        InputError: If a file of that name with other content exists, or the folder cannot be
            written; nothing is then written.
    """
    sources = [path for kind in (BENCH, POOL) for path in sorted(kind.iterdir())]
    targets = [Path(folder) / source.parent.name / source.name for source in sources]
    for source, target in zip(sources, targets, strict=True):
        check_writable(target)
        if target.exists() and target.read_bytes() != source.read_bytes():
            raise InputError(target, "", "a file with other content", "no such file")
    return [
        write_whole(target, source.read_bytes())
        for source, target in zip(sources, targets, strict=True)
    ]
