"""``sim2real forecast``."""

from __future__ import annotations

import argparse

from rl import verbs
from sim2real.commands.command import arguments_of
from sim2real.errors import if_installed
from sim2real.output import beside, check_writable, is_stream, write_json


def run(options: argparse.Namespace) -> int:
    """Forecast, print and write the intervals, and a page; trials so far are kept."""
    import torch

    torch.set_num_threads(1)
    out = check_writable(options.out)
    kept = None if is_stream(out) else beside(out, f"{out.stem}.trials.npz")
    forecast = verbs.forecast(**arguments_of(verbs.forecast, options, kept=kept))
    options.result = forecast.content()
    write_json(out, options.result)
    print(forecast)
    if not options.no_page:
        page = beside(out, f"{out.stem}.html")
        with if_installed("page"):
            from rl.forecast.forecast import write_forecast_page

            write_forecast_page(forecast, page)
            print(f"\npage: {page}")
    return 0
