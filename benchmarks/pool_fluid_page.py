"""What the diagnosis in the fluid says of the shipped swims, beside what they conceal.

    python benchmarks/pool_fluid_page.py [DIAGNOSIS.json ...]

Gathers diagnoses by ``sim2real diagnose --water`` into ``reports/pool_diagnosis/fluid.json``, where
there are any, then prints its table and draws its figure: each parameter over its true value.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.output import write_json
from sim2real.report.drawing import save_png
from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

OUT = Path("reports/pool_diagnosis")
TRUTH = Path("datasets/pool/truth.json")
SIGNALS = ("surge", "sway", "yaw_rate")


def gathered(paths: list[Path]) -> dict[str, Any]:
    """What is kept of diagnoses: names, parameters, errors."""
    out = {}
    for path in paths:
        found = json.loads(path.read_text())
        keys = ("effect", "component", "probability", "group", "parameters")
        out[path.name.partition(".")[0]] = {
            "verdict": found["verdict"],
            "named": [{key: one[key] for key in keys} for one in found["effects"]],
            "rivals": found["rivals"][:3],
            "heldout": {
                fit: {name: found["fit"][fit][f"body.{name}"]["heldout"] for name in SIGNALS}
                for fit in ("baseline", "enriched")
            },
        }
    return out


def rows(content: dict[str, Any], truth: dict[str, Any]) -> list[tuple[str, float, float, float]]:
    """Label, estimate over truth and its interval, for what is concealed and named."""
    out = []
    for world in truth["worlds"]:
        named = content.get(world["name"], {}).get("named", [])
        for full, parameters in world["effects"].items():
            effect, _, material = full.partition(".")
            for one in named:
                if one["effect"] == effect and (not material or one["component"] == material):
                    for name, value in parameters.items():
                        found = one["parameters"][name]
                        ends = sorted((found["q05"] / value, found["q95"] / value))
                        stem = name.partition("_")[0]
                        last = "" if stem in effect.split("_") else stem
                        words = f"{effect} {material} {last}".replace("_", " ")
                        label = " ".join(f"{world['name']}: {words}".split())
                        out.append((label, found["mean"] / value, *ends))
    return out


def figure(listed: list[tuple[str, float, float, float]]):  # noqa: ANN201 - Matplotlib is lazy
    """Estimates over truths with 90 % intervals."""
    with house_style():
        drawn = new_figure(40 + 26 * len(listed), "what was named, over what is true")
        axes = drawn.subplots()
        for k, (_, mean, low, high) in enumerate(listed):
            axes.plot([low, high], [k, k], color=ACCENT, linewidth=2)
            axes.plot(mean, k, "o", color=INK, markersize=4)
        axes.axvline(1.0, color=FAINT, linewidth=1)
        axes.set_yticks(range(len(listed)), [label for label, *_ in listed])
        axes.invert_yaxis()
        axes.set_xlim(min(row[2] for row in listed) - 0.05, max(row[3] for row in listed) + 0.05)
        axes.set_xlabel("estimate over truth, 90 % interval")
    return drawn


def main() -> None:
    """Gather, print, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("diagnoses", nargs="*", type=Path)
    options = parser.parse_args()
    if options.diagnoses:
        write_json(OUT / "fluid.json", gathered(options.diagnoses))
    content = json.loads((OUT / "fluid.json").read_text())
    truth = json.loads(TRUTH.read_text())
    for name, one in content.items():
        told = "; ".join(
            f"{x['effect']} ({x['component']}) {x['probability']:.2f}: "
            + ", ".join(f"{p} {v['mean']:.3g}" for p, v in x["parameters"].items())
            for x in one["named"]
        )
        errors = [float(np.hypot(fit["surge"], fit["sway"])) for fit in one["heldout"].values()]
        print(f"{name}: {told or 'nothing'}; speed {errors[0]:.4f}, {errors[1]:.4f} m/s")
        print("   ", one["heldout"])
    listed = rows(content, truth)
    inside = sum(low <= 1 <= high for _, _, low, high in listed)
    print(f"{inside} of {len(listed)} intervals hold the truth")
    print(save_png(figure(listed), OUT / "fluid.png"))


if __name__ == "__main__":
    main()
