"""Make two sealed sets out of real recordings: changes put into them, and changes really made.

    python datasets/concealed/real.py OUT2 OUT3 --realdata DIR --seed S

Layout and answers are those of ``make.py``, with ``tier`` in each answer. Real servos do more
than a plain PD servo, so a case holds recordings of the same rig as they are, ``ref_1``,
``ref_2``, ...: the solver makes its reference of these and says what else is in ``a`` (and
``b``). A null is *nothing changed*. Recordings hold time, set-points and angles only, sidecars no
metadata. ``backgrounds.py`` says what the logs are, ``injections.py`` (T2) and
``interventions.py`` (T3) what is in ``a``.
"""

from __future__ import annotations

import argparse
import secrets
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from backgrounds import backgrounds
from injections import COUNTS, injected
from interventions import concealed
from real_files import write


def main(arguments: Sequence[str] | None = None) -> None:
    """Write both sets."""
    parser = argparse.ArgumentParser(description="Make sealed sets out of real recordings.")
    parser.add_argument("out2", type=Path, metavar="OUT2", help="changes put in (T2)")
    parser.add_argument("out3", type=Path, metavar="OUT3", help="changes really made (T3)")
    parser.add_argument("--realdata", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, help="default: drawn and kept in the answers")
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N", help="cases of T2")
    options = parser.parse_args(arguments)
    for out in (options.out2, options.out3):
        if out.exists() and any(out.iterdir()):
            parser.error(f"{out} is not empty")
    if not options.realdata.is_dir():
        parser.error(f"no folder {options.realdata}")
    seed = secrets.randbits(64) if options.seed is None else options.seed
    second, third = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    groups = backgrounds(options.realdata)
    counts = {kind: getattr(options, kind) for kind in COUNTS}
    write(injected(groups, counts, second), seed, options.out2)
    write(concealed(groups, third), seed, options.out3)


if __name__ == "__main__":
    main()
