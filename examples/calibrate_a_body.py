"""A swim in a pool to a calibrated body, by the reduced-order twin."""

import argparse
from pathlib import Path

import sim2real as s2r

POOL = Path("datasets/pool")


def main() -> None:
    """Calibrate, print, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--seconds", type=float, default=30.0, help="of the swim (default 30)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    swim = s2r.read_recording(POOL / "p1.csv")
    swim = swim.between(0, int((swim.t <= swim.t[0] + options.seconds).sum()))
    found = s2r.calibrate(swim, POOL / "robot.toml", POOL / "model.json")
    print(found)
    s2r.write_model(found.model, options.out / "calibrated.json")
    found.plot().savefig(options.out / "calibration.png")


if __name__ == "__main__":
    main()
