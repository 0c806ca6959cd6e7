"""The error of energy in forecasts by the twin, from trials in several waters.

    python benchmarks/forecast_realities.py swim OUT --seed 8 --groups 8 --in-group 8
    python benchmarks/forecast_realities.py forecast OUT
    python benchmarks/forecast_energy.py OUT

Writes ``rl/forecast/twin_error.json``: how real energy differs from that forecast, policy by
policy: the median of the logarithm of their ratio, and half the distance of its 16 % and 84 %
quantile, so that the few robots whose joints oscillate do not decide, less the spread that the
other parameters of a draw explain. Each water is left out in turn, which shows how certain the two
are.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from rl.forecast.realities import DEVIATIONS, TWIN_ERROR
from sim2real.arrays import Array
from sim2real.output import write_json


def robust(errors: Array) -> tuple[float, float]:
    """Median of errors, and their standard deviation beyond the forecasts' own, shape (n, 2).

    Columns are the error and the standard deviation of what was forecast without it.
    """
    low, middle, high = np.quantile(errors[:, 0], [0.16, 0.5, 0.84])
    variance = ((high - low) / 2) ** 2 - np.median(errors[:, 1] ** 2)
    return float(middle), float(np.sqrt(max(variance, 0.0)))


def main() -> None:
    """Measure the error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    out: Path = parser.parse_args().out
    ratio: dict[int, list[tuple[float, float]]] = {}
    realities = 0
    for path in sorted((out / "forecasts").glob("??-??.npz")):
        g, r = map(int, path.stem.split("-"))
        answers = json.loads((out / "answers" / f"{g:02d}.json").read_text())
        who, ok = np.array(answers["who"]), ~np.array(answers["stopped"])[r]
        real = np.array(answers["energy"], dtype=np.float64)[r]
        with np.load(path) as kept:
            error = kept["parameters"][:, list(kept["names"]).index(DEVIATIONS[3])]
            forecast = np.log(kept["full.energy"] / (1 + error[:, None])).mean(axis=2)
        for k in set(who[ok]):
            found = float(np.log(real[(who == k) & ok]).mean() - forecast[k].mean())
            ratio.setdefault(g, []).append((found, float(forecast[k].std())))
        realities += 1
    for g in ratio:
        others = [x for k, values in ratio.items() if k != g for x in values]
        print("without water", g, *robust(np.array(others)))
    middle, sd = robust(np.array([x for values in ratio.values() for x in values]))
    origin = {"waters": len(ratio), "realities": realities}
    write_json(TWIN_ERROR, {"from": origin, "energy": {"mean": middle, "sd": sd}})


if __name__ == "__main__":
    main()
