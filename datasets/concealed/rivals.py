"""What a user would do today on the same cases, graded by the same script.

Needs ``pip install pysindy scikit-learn``.

python datasets/concealed/rivals.py SET OUT [--limit 60] [--methods refit iid_BIC SINDy GP_residual]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from grade import grade
from rival_bic import ranked_by_bic
from rival_case import Case, Said, answer, read_case
from rival_gp import gaussian_process
from rival_sindy import sparse_regression

from sim2real.output import write_json

Method = Callable[[Case], Said]


def main(arguments: Sequence[str] | None = None) -> None:
    """Answer the first cases with each method, grade them and say how long they took."""
    parser = argparse.ArgumentParser(description="What a user would do today.")
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--limit", type=int, default=60)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    options = parser.parse_args(arguments)
    spent = dict.fromkeys(options.methods, 0.0)
    for folder in sorted((options.set / "inputs").iterdir())[: options.limit]:
        case = read_case(folder, options.set / "heldout" / folder.name / "c.csv")
        for method in options.methods:
            start = time.perf_counter()
            answer(case, news(case, METHODS[method]), options.out / method / folder.name)
            spent[method] += time.perf_counter() - start
        said = ", ".join(f"{method} {seconds:.0f} s" for method, seconds in spent.items())
        print(f"{folder.name}: {said}", flush=True)
    for method in options.methods:
        found = grade(options.set, options.out / method, answered=True)
        write_json(options.out / f"{method}.json", found)


def news(case: Case, method: Method) -> Said:
    """What a method says, less what it also says of the recordings in which nothing is hidden."""
    said = method(case)
    if case.before is None:
        return said
    known = {(one["effect"], one["component"]) for one in method(case.before).effects}
    left = (one for one in said.effects if (one["effect"], one["component"]) not in known)
    return replace(said, effects=tuple(left))


def refit(case: Case) -> Said:
    """Refit gains and latency; blame nothing."""
    return Said((), case.model)


METHODS: dict[str, Method] = {
    "refit": refit,
    "iid_BIC": ranked_by_bic,
    "SINDy": sparse_regression,
    "GP_residual": gaussian_process,
}

if __name__ == "__main__":
    main()
