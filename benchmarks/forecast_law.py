"""The twin's error in forecasts, from calibrations and trials in several waters.

    python benchmarks/forecast_realities.py swim OUT --seed 8 --groups 8 --in-group 8
    python benchmarks/forecast_realities.py forecast OUT
    python benchmarks/forecast_law.py OUT

Writes ``rl/forecast/twin_error.json``: how far laws that were calibrated on one swim are from that
fitted to the fluid, and how real energy differs from that forecast: its median over realities and
half the distance of the 16 % and 84 % quantile, so that the few robots whose joints oscillate do
not decide. Each water is left out in turn, which shows how certain the two are. The prior of the
law, ten percent of each coefficient, is chosen: with it forecasts of time vary as real times do.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from rl.forecast import twin_error
from rl.forecast.realities import DEVIATIONS
from sim.twin.law import FITTED
from sim2real.arrays import Array
from sim2real.model import read_model
from sim2real.output import write_json


def robust(values: Array) -> tuple[float, float]:
    """Median, and half the distance of the 16 % and 84 % quantile."""
    low, middle, high = np.quantile(values, [0.16, 0.5, 0.84])
    return float(middle), float(high - low) / 2


def main() -> None:
    """Measure the error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    out: Path = parser.parse_args().out
    law: dict[str, list[float]] = {}
    ratio: dict[int, list[float]] = {}
    for path in sorted((out / "forecasts").glob("??-??.npz")):
        model = read_model(path.with_suffix(".model.json"))
        for name in model.body["posterior"]["names"]:
            if name.startswith("twin."):
                at, usual = model.body["twin"][name[5:]], getattr(FITTED, name[5:])
                law.setdefault(name, []).append(at - usual)
        g, r = map(int, path.stem.split("-"))
        answers = json.loads((out / "answers" / f"{g:02d}.json").read_text())
        who, ok = np.array(answers["who"]), ~np.array(answers["stopped"])[r]
        real = np.array(answers["energy"], dtype=np.float64)[r]
        with np.load(path) as kept:
            error = kept["parameters"][:, list(kept["names"]).index(DEVIATIONS[3])]
            forecast = np.log(kept["full.energy"] / (1 + error[:, None])).mean(axis=(1, 2))
        found = [np.log(real[(who == k) & ok]).mean() - forecast[k] for k in set(who[ok])]
        ratio.setdefault(g, []).append(float(np.mean(found)))
    for g in ratio:
        others = [x for k, values in ratio.items() if k != g for x in values]
        print("without water", g, *robust(np.array(others)))
    middle, sd = robust(np.array([x for values in ratio.values() for x in values]))
    content = json.loads(twin_error.FILE.read_text())
    content["from"] = {"waters": len(ratio), "realities": sum(map(len, ratio.values()))}
    content["swim"] = {k: float(np.sqrt(np.mean(np.square(x)))) for k, x in law.items()}
    content["energy"] = {"mean": middle, "sd": sd}
    write_json(twin_error.FILE, content)


if __name__ == "__main__":
    main()
