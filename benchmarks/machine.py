"""How fast this machine is, as a unit for times that are to be compared between machines.

python benchmarks/machine.py
"""

from __future__ import annotations

import time

ADDITIONS = 10_000_000


def seconds_per_ten_million_additions(repeats: int = 3) -> float:
    """Seconds that ten million additions in a Python loop take; the least of some tries.

    The least is what an idle machine takes: other programs only add to it.
    """
    return min(_additions() for _ in range(repeats))


def _additions() -> float:
    """The loop as a script has it, its variables global."""
    loop = compile(
        f"total = 0\nfor number in range({ADDITIONS}): total = total + number", "", "exec"
    )
    start = time.perf_counter()
    exec(loop, {})
    return time.perf_counter() - start


if __name__ == "__main__":
    print(f"A = {seconds_per_ten_million_additions():.2f} s: ten million additions in a loop")
