"""A real fish's film, calibrated and diagnosed in the twin: what is missing, and does it help?

    python benchmarks/real_fish_diagnosis.py FOLDER [--out reports] [--tool]

FOLDER holds four clips of a tendon-driven robot fish filmed from above. The twin's joints move as
they were filmed, its body is free. What is fitted, chosen or named has never seen the clip it is
scored on: one clip is left out in turn, then two. Rivals without physics are fitted likewise.
Writes ``real_fish_diagnosis.json``, of which ``real_fish_page.py`` makes a part of its page.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filmed import MEASURES, Film, beat, film, irregular, jitter
from left_out import ENOUGH, Pool, blocks, catalogue, leave_out, pool
from real_fish import CLIPS, FRAMES, RIVAL_M_S, floating
from tqdm import tqdm

import sim2real as s2r
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.swims import Swim
from sim2real.arrays import Array
from sim2real.output import write_json

PAIRS = (
    ("calibrated", "uncalibrated"),
    ("calibrated", "by the beat"),
    ("calibrated", "regression"),
    ("likeliest effect", "calibrated"),
)
_DRAWS = 10_000
SHOWN, DRAWN = 2, ("regression", "uncalibrated", "calibrated")
"""The clip whose speeds are drawn over time, and whose predictions."""


def interval(by_clip: Array, rng: np.random.Generator) -> Array:
    """90 % of bootstrap means over clips, of rows (clips, ...), shape (2, ...)."""
    drawn = rng.integers(0, len(by_clip), (_DRAWS, len(by_clip)))
    return np.asarray(np.quantile(by_clip[drawn].mean(axis=1), (0.05, 0.95), axis=0))


def table(found: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Any]:
    """Means over clips with their intervals, by predictor."""
    return {
        name: {"by_clip": rows, "mean": rows.mean(axis=0), "interval": interval(rows, rng)}
        for name, rows in found.items()
    }


def against(rows: Array, others: Array, rng: np.random.Generator) -> dict[str, Any]:
    """Errors less others', clip by clip: mean, interval, on how many clips they are less."""
    off = rows - others
    return {
        "mean": off.mean(axis=0),
        "interval": interval(off, rng),
        "better_on": [int(k) for k in (off < 0).sum(axis=0)],
    }


def beats(film: Film, said: Mapping[str, Array]) -> dict[str, Any]:
    """Amplitudes of sway and yaw rate at the beat, and their phases against the first joint."""
    out = {}
    for name, speeds in {"filmed": film.speeds, **said}.items():
        _, sway, turn, joint = beat(film, speeds)
        phases = [float(np.degrees(np.angle(one / joint))) for one in (sway, turn)]
        out[name] = {"amplitude": [abs(sway), abs(turn)], "phase_deg": phases}
    return out


def tool(place: Pool, films: Sequence[Film], robot: s2r.Robot) -> dict[str, Any]:
    """What ``sim2real diagnose`` says of all clips at once; it scores on the last third of each."""

    def simulate(models: Sequence[s2r.Model], swim: Swim) -> Array:
        return place.simulator(models, swim.command, swim.start)

    found = diagnose_swims([one.swim for one in films], place.model, robot, simulate)
    return {
        "verdict": found.verdict,
        "named": {one.effect: one.probability for one in found.effects},
        "told": list(found.gate),
        "statements": [one.statement for one in found.effects if one.probability >= 0.5],
        "considered": {one.effect: one.probability for one in found.rivals},
    }


def main() -> None:
    """Fit, score, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--tool", action="store_true", help="renew only what diagnose says")
    options = parser.parse_args()
    if not (options.folder / f"{CLIPS[0]}.csv").is_file():
        raise SystemExit(f"no clips in {options.folder}: nothing done")
    start, rng = time.perf_counter(), np.random.default_rng(0)
    robot = floating(s2r.read_robot(options.folder / "robot.toml"))
    place, effects = pool(robot), catalogue(robot)
    rates = {rate: [film(options.folder, name, robot, rate) for name in CLIPS] for rate in FRAMES}
    films = rates[FRAMES[0]]
    if options.tool:
        before = json.loads((options.out / "real_fish_diagnosis.json").read_text())
        before["tool"] = plain(tool(place, films, robot))
        write_json(options.out / "real_fish_diagnosis.json", before)
        print(before["tool"])
        return
    with tqdm(total=14, desc="splits", disable=None) as bar:
        one = leave_out(place, films, effects, 3, bar.update)
        two = leave_out(place, films, (), 2, bar.update)
        other = leave_out(place, rates[FRAMES[1]], (), 3, bar.update)
    noise = {
        "jitter of the tracker": [jitter(options.folder, n, robot, FRAMES[0]) for n in CLIPS],
        "not periodic": [irregular(film) for film in films],
    }
    scores = one["errors"]
    found = {
        "clips": CLIPS,
        "measures": MEASURES,
        "published_simulator_m_s": RIVAL_M_S,
        "measured": [_measured(film) for film in films],
        "one_left_out": table(one["errors"], rng),
        "two_left_out": table(two["errors"], rng),
        "one_left_out_at_80": table(other["errors"], rng),
        "noise": table({name: np.array(rows) for name, rows in noise.items()}, rng),
        "against": {
            f"{name} less {other}": against(scores[name], scores[other], rng)
            for name, other in PAIRS
        },
        "at_the_beat": {
            film.swim.name: beats(film, one["tracks"][film.swim.name]) for film in films
        },
        "splits": one["splits"],
        "splits_of_two": two["splits"],
        "splits_at_80": other["splits"],
        "predicted_speed": {
            clip: {name: track[:, 0].mean() for name, track in said.items()}
            for clip, said in one["tracks"].items()
        },
        "film": _shown(films[SHOWN], one["tracks"][CLIPS[SHOWN]]),
        "enough": ENOUGH,
        "blocks": blocks([one.swim for one in films[1:]]),
        "tool": tool(place, films, robot),
        "seconds": time.perf_counter() - start,
    }
    write_json(options.out / "real_fish_diagnosis.json", plain(found))
    for name, row in found["one_left_out"].items():
        print(f"{name:36s}", *(f"{v:8.4f}" for v in row["mean"]))
    print(found["tool"], f"{found['seconds']:.0f} s")


def _measured(film: Film) -> dict[str, Any]:
    square = np.sqrt(np.mean(film.speeds**2, axis=0))
    return {"beat_hz": film.beat_hz, "speed": film.speeds[:, 0].mean(), "rms": square}


def _shown(film: Film, tracks: Mapping[str, Array]) -> dict[str, Any]:
    """Speeds of one clip over time, as filmed and as predicted."""
    said = {"filmed": film.speeds} | {name: tracks[name] for name in DRAWN}
    return {"name": film.swim.name, "t": film.swim.t} | {k: v.T for k, v in said.items()}


def plain(value: Any) -> Any:  # noqa: ANN401
    """Of arrays and their numbers, what JSON takes: five digits, nothing that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.5g}") if np.isfinite(value) else None
    return value


if __name__ == "__main__":
    main()
