"""How sure the identified numbers are, and the ranges that training should draw from."""

import argparse
from pathlib import Path

import sim2real as s2r
from sim2real.ranges.entry import write_ranges

DATA = Path("datasets/servo_steps")


def main() -> None:
    """Sample, print, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--steps", type=int, default=1000, help="of each chain (default 1000)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    recordings = [DATA / "steps.csv", DATA / "square.csv"]
    model = s2r.identify(recordings, DATA / "robot.toml")
    chain = {"steps": options.steps, "walkers": 16, "seed": 1}
    found = s2r.ranges(recordings, DATA / "robot.toml", model, **chain)
    print(found)
    write_ranges(found.ranges, options.out / "ranges.json")
    found.plot().savefig(options.out / "latency.png")


if __name__ == "__main__":
    main()
