"""Recordings of three servos to a model, scored on a chirp that the fit has not seen."""

import argparse
from pathlib import Path

import sim2real as s2r

DATA = Path("datasets/servo_steps")


def main() -> None:
    """Identify, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)

    recordings = [s2r.read_recording(DATA / f"{name}.csv") for name in ("steps", "square", "chirp")]
    model = s2r.identify(recordings, DATA / "robot.toml")
    print(model)
    s2r.write_model(model, out / "model.json")

    prediction = s2r.predict(recordings[-1], DATA / "robot.toml", model)
    print(prediction)
    prediction.plot(joint="j1").savefig(out / "chirp.png")


if __name__ == "__main__":
    main()
