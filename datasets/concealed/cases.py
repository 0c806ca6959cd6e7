"""A case: three servos, what is hidden in them, and three recordings of their motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from bench import JOINTS, RECORDINGS, Servo, draw_servo
from catalogue import EFFECTS, Scale
from clock import disturbed_ticks, draw_disturbance, empty_cells, ordinary_ticks
from excitation import signal
from numpy.typing import NDArray
from outside import OUTSIDERS, draw_windows
from rollout import CURRENT_SQUARE, DUTY_PEAK, TORQUE_PEAK
from sensor import noise, quantize, stick
from world import Hidden, Window, World, build_world

Array = NDArray[np.float64]

WEAKEST, STRONGEST = 0.1, 3.0  # of a single effect, in units of the nominal strength
WEAKEST_OF_TWO = 0.5
SAME_JOINT_SHARE = 2 / 3
STRAY_SHARE = 0.1  # of other cases that also have a disturbed clock, and likewise a model
TRIES = 40  # on one set of servos
LARGEST_READING_RAD = 2.5  # beyond it the plant is at fault, not the servo
MARGIN = (1.1, 1.5)  # of the stall torque over the largest torque asked for


@dataclass
class Take:
    """One recording of a case: T samples; times in s, angles in rad.

    ``t`` (T,), ``command`` and ``measured`` (T, 3), ``chance`` (2, T) of the link, and the windows
    in which intermittent physics acts.
    """

    t: Array
    command: Array
    chance: Array
    windows: list[Window] = field(default_factory=list)
    measured: Array = field(default_factory=lambda: np.empty((0, 3)))


@dataclass
class Case:
    """What is recorded and what is hidden in it.

    ``trap`` and ``disturbed`` (the clock) are no physics; ``model``, if any, is given to the tool
    and its numbers may be wrong.
    """

    kind: str
    servos: list[Servo]
    hidden: list[Hidden]
    takes: dict[str, Take]
    trap: str = ""
    disturbed: bool = False
    model: dict[str, dict[str, float]] = field(default_factory=dict)
    model_wrong: bool = False

    def world(self, recording: str, hidden: list[Hidden] | None = None) -> World:
        """The world of a recording; with other effects in it if ``hidden`` is given."""
        chosen = self.hidden if hidden is None else hidden
        return build_world(self.servos, recording, chosen, self.takes[recording].windows)


def draw_case(kind: str, name: str, rng: np.random.Generator) -> tuple[Case, list[Scale]]:
    """A case of a kind, and the scales of its three servos.

    Args:
        kind: ``null``, ``trap``, ``single``, ``double`` or ``outside``.
        name: Which effect (single), which physics (outside), which trap; else unused.
        rng: Source of everything random.
    """
    servos = [draw_servo(rng) for _ in JOINTS]
    stray = rng.random() < STRAY_SHARE and kind not in ("null", "trap")
    disturbed = stray or name == "clock"
    takes = {recording: _draw_take(recording, disturbed, rng) for recording in RECORDINGS}
    case = Case(kind, servos, [], takes, name if kind == "trap" else "", disturbed)
    scales = _settle(case, rng)
    if kind == "single":
        case.hidden = [_draw_effect(name, int(rng.integers(3)), WEAKEST, scales, rng)]
    elif kind == "double":
        case.hidden = _draw_pair(scales, rng)
    elif kind == "outside" and not _hide_outsider(case, name, rng):
        return draw_case(kind, name, rng)  # on other servos
    given = rng.random() < STRAY_SHARE and kind not in ("null", "trap")
    if given or name == "wrong_parameters":
        case.model_wrong = bool(rng.random() < 0.5) or name == "wrong_parameters"
        case.model = _draw_model(servos, wrong=case.model_wrong, rng=rng)
    for recording, take in takes.items():
        take.measured = _measure(case, recording, rng)
        if disturbed:
            take.measured[empty_cells(take.measured.shape, rng)] = np.nan
    return case, scales


def _draw_take(recording: str, disturbed: bool, rng: np.random.Generator) -> Take:
    t = disturbed_ticks(draw_disturbance(rng), rng) if disturbed else ordinary_ticks(rng)
    command = np.stack([signal(recording, t, rng) for _ in JOINTS], axis=1)
    return Take(t, command, rng.random((2, t.size)))


def _settle(case: Case, rng: np.random.Generator) -> list[Scale]:
    """Give each motor a stall torque above all that is asked of it; return the scales."""
    figures = []
    for recording, take in case.takes.items():
        world = case.world(recording)
        figures.append(world.motion(take.t, take.command, take.chance, range(3)).figures)
    scales = []
    for j, servo in enumerate(case.servos):
        before = servo.fields("a")
        asked = max(figure[j, DUTY_PEAK] for figure in figures) * servo.stall_Nm
        servo.stall_Nm = float(np.ceil(asked * rng.uniform(*MARGIN) * 100) / 100)
        # The same torque takes another current once the winding is known.
        current = before["torque_constant"] / servo.fields("a")["torque_constant"]
        scales.append(
            Scale(
                servo=servo,
                peak_torque_Nm=max(float(figure[j, TORQUE_PEAK]) for figure in figures[:2]),
                mean_square_current_A2=float(figures[0][j, CURRENT_SQUARE] * current**2),
                least_latency_s=min(one.latency_s for one in case.servos),
            )
        )
    return scales


def _draw_effect(
    name: str, joint: int, weakest: float, scales: list[Scale], rng: np.random.Generator
) -> Hidden:
    strength = float(weakest * (STRONGEST / weakest) ** rng.random())
    return make_effect(name, joint, strength, scales[joint], rng.random(3))


def make_effect(name: str, joint: int, strength: float, scale: Scale, shape: Array) -> Hidden:
    """An effect of the catalogue at a strength and a shape (3,)."""
    effect = EFFECTS[name]
    own = effect.place == "joint"
    return Hidden(
        effect=name,
        component=JOINTS[joint] if own else effect.place,
        parameters=effect.draw(strength, scale, shape),
        strength=strength,
        driver=effect.driver,
        joint=joint if own else None,
        hide=effect.hide,
    )


def _draw_pair(scales: list[Scale], rng: np.random.Generator) -> list[Hidden]:
    same = rng.random() < SAME_JOINT_SHARE
    names = [n for n, e in EFFECTS.items() if e.place == "joint" or not same]
    while True:
        pair = [str(n) for n in rng.choice(names, size=2, replace=False)]
        first, second = (EFFECTS[n] for n in pair)
        if same and first.family and first.family == second.family:
            continue
        if first.place != "joint" and second.place != "joint":
            continue
        break
    joints = rng.permutation(3)[:2]
    if same:
        joints[1] = joints[0]
    return [
        _draw_effect(n, int(j), WEAKEST_OF_TWO, scales, rng)
        for n, j in zip(pair, joints, strict=True)
    ]


def _hide_outsider(case: Case, name: str, rng: np.random.Generator) -> bool:
    """Draw until it shows above the noise, in every window or over the whole; whether it does."""
    kind = OUTSIDERS[name]
    for _ in range(TRIES):
        joint = int(rng.integers(3))
        parameters = kind.draw(case.servos, joint, rng)
        hidden = Hidden(name, JOINTS[joint], parameters, 1.0, kind.driver, joint, kind.hide)
        case.hidden = [hidden]
        for recording, windows in draw_windows(kind, rng).items():
            case.takes[recording].windows = windows
        if _shows(case, joint):
            return True
    return False


def _shows(case: Case, joint: int) -> bool:
    sensor = case.servos[joint].sensor
    floor = 3 * np.hypot(sensor.white_rad, sensor.step_rad / np.sqrt(12))
    for recording in ("a", "b"):
        take = case.takes[recording]
        plain = case.world(recording, []).seen(take.t, take.command, take.chance, [joint])[0]
        world = case.world(recording)
        seen = world.seen(take.t, take.command, take.chance, [joint])[0]
        if joint in world.stuck:
            seen = stick(seen, take.t, take.windows)
        always = OUTSIDERS[case.hidden[0].effect].lasts_s is None
        for start, stop in [(0.0, np.inf)] if always else take.windows:
            inside = (take.t >= start) & (take.t < stop)
            if not inside.any() or np.sqrt(np.mean((seen - plain)[inside] ** 2)) < floor:
                return False
    return True


def _measure(case: Case, recording: str, rng: np.random.Generator) -> Array:
    take, world = case.takes[recording], case.world(recording)
    seen = world.seen(take.t, take.command, take.chance, range(3))
    if np.abs(seen).max() > LARGEST_READING_RAD or not np.isfinite(seen).all():
        raise RuntimeError(f"a joint ran away with {[one.effect for one in case.hidden]} hidden")
    measured = np.empty((take.t.size, 3))
    for j, servo in enumerate(case.servos):
        noisy = seen[j] + noise(servo.sensor, take.t, rng)
        measured[:, j] = quantize(noisy, world.steps_rad[j])
        if j in world.stuck:
            measured[:, j] = stick(measured[:, j], take.t, take.windows)
    return measured


def _draw_model(
    servos: Sequence[Servo], *, wrong: bool, rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """A model of the servos whose numbers are off by 15 to 50 %, or by at most 3 %."""
    low, high = (0.15, 0.5) if wrong else (0.0, 0.03)

    def off(value: float) -> float:
        return round(value * (1 + rng.uniform(low, high) * rng.choice([-1.0, 1.0])), 6)

    return {
        joint: {
            "kp_Nm_per_rad": off(servo.kp),
            "kd_Nms_per_rad": off(servo.kd),
            "latency_s": off(servo.latency_s),
            "inertia_kgm2": servo.loads["a"].inertia_kgm2,
        }
        for joint, servo in zip(JOINTS, servos, strict=False)
    }
