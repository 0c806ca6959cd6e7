"""``sim2real forecast``."""

from __future__ import annotations

import argparse
import sys

from rl import verbs
from sim2real.commands.verb import arguments_of
from sim2real.output import check_writable, write_json


def run(options: argparse.Namespace) -> int:
    """Forecast, print and write the intervals, and a page; trials so far are kept."""
    import torch

    torch.set_num_threads(1)
    out = check_writable(options.out)
    kept = out.with_suffix(".trials.npz")
    forecast = verbs.forecast(**arguments_of(verbs.forecast, options, kept=kept))
    print(forecast)
    options.result = forecast.content()
    write_json(out, options.result)
    if not options.no_page:
        try:
            from rl.forecast.page import write_forecast_page

            write_forecast_page(forecast, out.with_suffix(".html"), film=options.film)
        except ModuleNotFoundError as error:
            print(f"no page: {error}", file=sys.stderr)
        else:
            print(f"\npage: {out.with_suffix('.html')}")
    return 0
