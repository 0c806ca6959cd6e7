"""``sim2real density``."""

from __future__ import annotations

import argparse

from sim2real import verbs
from sim2real.errors import InputError
from sim2real.model import read_model, write_model
from sim2real.output import check_writable
from sim2real.robot import with_density


def run(options: argparse.Namespace) -> int:
    """Print the table; write the model and the plot if requested."""
    for path in (options.out, options.plot):
        if path is not None:
            check_writable(path)
    if (options.model is None) != (options.out is None):
        missing, partner = ("--out", "--model") if options.out is None else ("--model", "--out")
        raise InputError(missing, "", "nothing", f"a file, to go with {partner}")
    density = verbs.density(options.robot)
    if options.out is not None:
        write_model(with_density(read_model(options.model), density), options.out)
    options.result = density
    print(density)
    if options.plot is not None:
        from sim2real.report.drawing import save_png

        save_png(density.plot(), options.plot)
    return 0
