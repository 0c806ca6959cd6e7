"""Make the recordings of this folder: three simulated servos, each turning a known load.

    python make.py --out FOLDER --seed 824

The motion is the exact solution of the servo's equation from one event to the next, not a numerical
one, and nothing is shared with the library: what it fits to these recordings can be judged against
``truth.json``.
"""

from __future__ import annotations

import argparse
import cmath
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DURATION_S = 30.0
REST_S = 0.5  # the first command is held this long before the signal begins
RATE_HZ = 50.0
JITTER_SD_S = 0.0003
NOISE_SD_RAD = 0.0015
POSITION_STEP_RAD = 0.00419
MISSING_SHARE = 0.002
GAPS = {"steps": slice(865, 871)}  # ticks at which the computer neither sends nor samples


@dataclass(frozen=True)
class Servo:
    """A servo and its load: I a = kp (command(t - latency) - position) - kd velocity, if it can.

    The motor gives no more than its torque-speed line, ``stall - (stall / no_load) velocity`` one
    way and ``-stall - (stall / no_load) velocity`` the other.
    """

    kp_Nm_per_rad: float
    kd_Nms_per_rad: float
    latency_s: float
    inertia_kgm2: float
    stall_torque_Nm: float = np.inf
    no_load_speed_rad_s: float = np.inf

    @property
    def line(self) -> float:
        """Damping of the torque-speed line, N m s."""
        limited = np.isfinite(self.stall_torque_Nm)
        return self.stall_torque_Nm / self.no_load_speed_rad_s if limited else 0.0

    def side(self, state: Array, target: float) -> int:
        """1 or -1 where the motor is at an end of its line, 0 where the controller has its way."""
        damping = self.kd_Nms_per_rad - self.line
        drive = self.kp_Nm_per_rad * (target - state[0]) - damping * state[1]
        return (1 if drive > 0 else -1) if abs(drive) > self.stall_torque_Nm else 0

    def moved(self, state: Array, target: float, side: int, dt: float) -> Array:
        """Position and velocity after ``dt`` on one side, exactly.

        Where the controller gets its way, the exponential of a 2 x 2 matrix A with eigenvalues
        -s +- i w, by Cayley-Hamilton: exp(A dt) = exp(-s dt) (cos(w dt) + sin(w dt) / w (A + s));
        w is imaginary where damping is strong.
        On the line the speed decays towards the no-load speed.
        """
        if side:
            rate = self.line / self.inertia_kgm2
            final = side * self.no_load_speed_rad_s
            fallen = (state[1] - final) * -math.expm1(-rate * dt)
            return np.array([state[0] + final * dt + fallen / rate, state[1] - fallen])
        stiffness = self.kp_Nm_per_rad / self.inertia_kgm2
        s = self.kd_Nms_per_rad / self.inertia_kgm2 / 2
        w = cmath.sqrt(stiffness - s**2)
        fade, cosine, sine = math.exp(-s * dt), cmath.cos(w * dt).real, (cmath.sin(w * dt) / w).real
        away, speed = state[0] - target, state[1]
        position = (cosine + sine * s) * away + sine * speed
        velocity = (cosine - sine * s) * speed - sine * stiffness * away
        return np.array([target + fade * position, fade * velocity])

    def advanced(self, state: Array, target: float, dt: float) -> Array:
        """Position and velocity after ``dt`` under one set-point, from side to side."""
        left = dt
        side = self.side(state, target)
        while True:
            looks = np.linspace(0.0, left, LOOKS + 1)[1:]
            leaves = next(
                (x for x in looks if self.side(self.moved(state, target, side, x), target) != side),
                None,
            )
            if leaves is None:
                return self.moved(state, target, side, left)
            stays = leaves - left / LOOKS
            for _ in range(50):
                middle = 0.5 * (stays + leaves)
                inside = self.side(self.moved(state, target, side, middle), target) == side
                stays, leaves = (middle, leaves) if inside else (stays, middle)
            state, left = self.moved(state, target, side, leaves), left - leaves
            side = self.side(state, target)


LOOKS = 16  # looks at the motor's side between two events, at most 20 ms apart

# What each servo is, beside the 1.67 N m and 5.24 rad/s of the LX-824's data sheet.
SERVOS = {
    "j1": Servo(1.38, 0.068, 0.0617, 0.0022, stall_torque_Nm=1.62, no_load_speed_rad_s=5.4),
    "j2": Servo(1.32, 0.083, 0.0680, 0.0018, stall_torque_Nm=1.71, no_load_speed_rad_s=5.1),
    "j3": Servo(1.25, 0.0435, 0.0734, 0.0015, stall_torque_Nm=1.55, no_load_speed_rad_s=4.9),
}


def simulate(servo: Servo, t: Array, sent: Array, command: Array) -> Array:
    """Position and velocity at the times ``t`` (T,), from rest on the first command; shape (T, 2).

    ``command`` (K,) leaves at the times ``sent`` (K,) and is held from one latency later. The
    motion between these events, and those at which the motor reaches or leaves its line, is known
    in closed form, so that there is no time step to choose.
    """
    arrival = sent + servo.latency_s
    times = np.union1d(t, arrival)
    held = command[np.maximum(np.searchsorted(arrival, times, side="right") - 1, 0)]
    states = [np.array([held[0], 0.0])]
    for dt, angle in zip(np.diff(times), held[:-1], strict=True):
        states.append(servo.advanced(states[-1], float(angle), float(dt)))
    return np.array(states)[np.searchsorted(times, t)]


def steps(t: Array, rng: np.random.Generator) -> Array:
    """Random levels held for random times; drawn anew for each joint."""
    changes = np.cumsum(rng.uniform(0.4, 1.5, size=100))
    return rng.uniform(-0.6, 0.6, size=101)[np.searchsorted(changes, t)]


def chirp(t: Array, _: np.random.Generator) -> Array:
    """A sine of 0.3 rad whose frequency rises evenly from 0.2 to 4 Hz."""
    rise = (4.0 - 0.2) / (DURATION_S - REST_S)
    return 0.3 * np.sin(2 * np.pi * (0.2 + rise * t / 2) * t)


SIGNALS: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "steps": steps,
    "sine": lambda t, _: 0.52 * np.sin(2 * np.pi * t),
    "square": lambda t, _: np.where(t % 2 < 1, 0.52, -0.52),
    "chirp": chirp,
}


def record(name: str, rng: np.random.Generator) -> dict[str, Array]:
    """The columns of recording ``name``, each of shape (T,); NaN where a sample is missing."""
    ticks = np.delete(np.arange(DURATION_S * RATE_HZ + 1), GAPS.get(name, slice(0)))
    t = ticks / RATE_HZ + rng.normal(0.0, JITTER_SD_S, size=ticks.size)
    t = np.round(t - t[0], 6)  # rounded before use: the file holds exactly what happened
    columns = {"t_s": t}
    for joint, servo in SERVOS.items():
        signal = SIGNALS[name](t - REST_S, rng)
        command = np.round(signal * (t >= REST_S), 6)
        noisy = simulate(servo, t, t, command)[:, 0] + rng.normal(0.0, NOISE_SD_RAD, size=t.size)
        measured = np.round(noisy / POSITION_STEP_RAD) * POSITION_STEP_RAD
        measured[rng.random(t.size) < MISSING_SHARE] = np.nan
        columns |= {f"{joint}.command_rad": command, f"{joint}.position_rad": measured}
    return columns


def main(arguments: Sequence[str] | None = None) -> None:
    """Write every recording with its sidecar, and ``truth.json``."""
    parser = argparse.ArgumentParser(description="Make the recordings of this folder.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, metavar="FOLDER")
    parser.add_argument("--seed", type=int, default=824)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    sidecar = {
        "schema": "sim2real.recording/1",
        "kind": "servo",
        "joints": list(SERVOS),
        "loads": {joint: {"inertia_kgm2": servo.inertia_kgm2} for joint, servo in SERVOS.items()},
        "medium": "air",
        "source": "Simulated, not measured on a robot: made by datasets/servo_steps/make.py "
        f"with seed {options.seed}. MIT licence.",
    }
    streams = np.random.default_rng(options.seed).spawn(len(SIGNALS))
    for name, rng in zip(SIGNALS, streams, strict=True):
        columns = record(name, rng)
        table = np.stack(list(columns.values()), axis=1)
        rows = [["" if np.isnan(x) else f"{x:z.6f}" for x in row] for row in table]
        lines = [",".join(cells) for cells in [list(columns), *rows]]
        (options.out / f"{name}.csv").write_text("\n".join(lines) + "\n")
        (options.out / f"{name}.json").write_text(json.dumps(sidecar, indent=2) + "\n")
    joints = {joint: asdict(servo) for joint, servo in SERVOS.items()}
    truth = {"seed": options.seed, "joints": joints, "noise_sd_rad": NOISE_SD_RAD}
    (options.out / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")


if __name__ == "__main__":
    main()
