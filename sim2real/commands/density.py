"""``sim2real density``."""

from __future__ import annotations

import argparse

from sim2real.density import Density, normalised_density, with_density
from sim2real.errors import InputError
from sim2real.model import read_model, write_model
from sim2real.output import check_writable
from sim2real.robot import read_robot


def run(options: argparse.Namespace) -> int:
    """Print the table; write the model and the plot where they are asked for."""
    for path in (options.out, options.png):
        if path is not None:
            check_writable(path)
    if (options.model is None) != (options.out is None):
        missing, other = ("--out", "--model") if options.out is None else ("--model", "--out")
        raise InputError(missing, "", "nothing", f"a file, to go with {other}")
    density = normalised_density(read_robot(options.robot))
    if options.out is not None:
        write_model(with_density(read_model(options.model), density), options.out)
    if options.png is not None:
        from sim2real.report.density_plot import density_figure
        from sim2real.report.drawing import save_png

        save_png(density_figure(density), options.png)
    print(table(density))
    return 0


def table(density: Density) -> str:
    """Mass, length and normalised density of each link."""
    width = max(len("link"), *(len(name) for name in density.links))
    lines = [f"{'link':<{width}}  mass, kg  length, m  density   90 % interval"]
    for k, name in enumerate(density.links):
        line = f"{name:<{width}}  {density.mass_kg[k]:8.3f}  {density.length_m[k]:9.3f}"
        line += f"  {density.value[k]:7.3f}"
        if density.interval is not None:
            low, high = density.interval[:, k]
            line += f"   {low:.3f} to {high:.3f}"
        lines.append(line)
    if density.interval is None:
        lines.append("  ! mass_sd_kg and length_sd_m of the links would give intervals")
    return "\n".join(lines)
