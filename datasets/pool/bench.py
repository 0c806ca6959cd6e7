"""A bench recording of the servos of the robot in ``clean.csv``: what a forecast of it needs.

    python datasets/pool/bench.py datasets/pool/forecast
    cd datasets/pool/forecast
    sim2real identify bench.csv --robot ../robot.toml --out bench_model.json
    sim2real calibrate ../clean.csv --robot ../robot.toml --model bench_model.json --out model.json
    sim2real ranges bench.csv ../clean.csv --robot ../robot.toml --model model.json \
        --steps 400 --walkers 16 --out ranges.json

Simulated, not measured: the servos of ``servos.py`` turn the loads of ``model.json`` in steps.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from camera import reported
from make import WORLDS
from servos import PERIOD_S, Servos

from sim2real.model import read_model
from sim2real.recording import Load, Recording, write_recording

SUBSTEPS = 200
LENGTH_S, REST_S = 20.0, 0.5


def main() -> None:
    """Turn, record, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    rng = np.random.default_rng(20261126)
    joints = read_model(Path(__file__).with_name("model.json")).joints
    inertia = np.array([joint.inertia_kgm2 for joint in joints.values()])
    t = PERIOD_S * np.arange(round(LENGTH_S / PERIOD_S))
    J, h = len(joints), PERIOD_S / SUBSTEPS
    changes = np.cumsum(rng.uniform(0.3, 1.0, (J, 60)), axis=1)
    level = rng.uniform(-0.6, 0.6, (J, 61))
    command = np.stack([level[j][np.searchsorted(changes[j], t)] for j in range(J)], axis=1)
    command = np.where(t[:, None] < REST_S, 0.0, command).round(3)
    servos = Servos(WORLDS[:1], J, h, rng)
    angle, rate, seen = np.zeros((1, J)), np.zeros((1, J)), []
    for k, row in enumerate(command):
        seen.append(angle[0])
        servos.send(t[k], row[None])
        for step in range(SUBSTEPS):
            rate = rate + h / inertia * servos.torque(t[k] + step * h, angle, rate, np.zeros(1))
            angle = angle + h * rate
    names = tuple(joints)
    recording = Recording(
        name="bench", kind="servo", joints=names, t=t, command=command,
        position=reported(np.array(seen), rng), medium="air",
        loads={n: Load(float(i)) for n, i in zip(names, inertia, strict=True)},
        source="Simulated, not measured: datasets/pool/bench.py. MIT licence.",
    )  # fmt: skip
    write_recording(recording, out / "bench.csv")


if __name__ == "__main__":
    main()
