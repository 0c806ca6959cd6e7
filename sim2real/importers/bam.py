"""Logs and parameters of BAM, Better Actuator Models (Rhoban, github.com/Rhoban/bam).

Its voltage-controlled servos, in its terms (kt, R, the firmware's gain g and the duty cycle per
gain and radian e, which BAM's programs state and its parameter files do not)::

    duty   d = clip(g e (command - q), -d_max, d_max)
    motor  m = kt (V d - kt q') / R, within kt times the largest current where the firmware has one
    dry    f = base + |Lm m - Le x| + exp(-|q' / vs|^a) (s + |Sm m - Se x|) + quadratic terms
    viscous  c q'

with the weight of the load x. M3 and M4 have one coefficient instead of Lm and Le, M1 and M2 none;
M1 and M3 have no Stribeck part. In the law ``motor`` (`sim2real.servo.motor`) this is::

    kp = kt V g e / R    kd = kt^2 / R + c
    stall torque K = kt V d_max / R    no-load speed K / kd

Viscous friction is thereby part of the torque to which load-dependent friction is proportional,
unlike in BAM. The exponent of the Stribeck part is 2 here; its speed is chosen such that the area
under the curve is the same. Source: Duclusaud, Passault, Padois, Ly, Extended Friction Models for
the Physics Simulation of Servo Actuators, ICRA 2025.
"""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError, one_of, shown
from sim2real.importers.options import check_increasing, import_warnings
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load, Recording
from sim2real.structured import Fields, finite_number, read_json

SAMPLE = ("timestamp", "goal_position", "torque_enable", "position")
COLUMNS = {"speed": "j1.velocity_rad_s", "load": "j1.load", "temp": "j1.temperature_C"}
COLUMNS |= {"input_volts": "supply_V"}
TEXTS = {"motor": "servo", "trajectory": "trajectory"}
NUMBERS = {"kp": "firmware_p_gain", "damping": "damping_gain", "vin": "supply_nominal_V"}
NUMBERS |= {"dt": "resampled_every_s"}
TOP = ("mass", "arm_mass", "length", "entries", *TEXTS, *NUMBERS)


def read_bam(path: str | os.PathLike[str]) -> Recording:
    """Read a raw (or resampled) BAM log, a JSON file, as a ``servo`` recording of joint ``j1``.

    Commands are empty while the torque is off, which is imported only at the end of a recording: if
    the torque is switched on again, the rest is omitted, as stated in ``metadata["left_out"]``.
    Speed, load, temperature and supply become columns if they were measured (a recorder writes 0
    throughout, or nothing, if not); ``metadata["not_imported"]`` lists the other fields. A hyphen
    in the name of a field, as in ``arm-mass``, is read as an underscore. ``InputError`` if a field
    does not conform to the format or the torque is off at the start.
    """
    top = _top(path)
    load, source = _load(top)
    entries = top.content.get("entries")
    if not isinstance(entries, list) or len(entries) < 2:
        found = f"{len(entries)} samples" if isinstance(entries, list) else "no list of samples"
        raise InputError(top.file, "entries", found, "at least two samples of a BAM log")
    samples = [Fields(top.file, f"entries[{k}]", entry) for k, entry in enumerate(entries)]
    t = np.array([sample.number("timestamp") for sample in samples])
    check_increasing(top.file, t, "entries[{}].timestamp", 0)
    off, stop = _torque(samples)
    command = [_angle(sample, "goal_position") for sample in samples[:off]]
    position = [_angle(sample, "position") for sample in samples]
    read = {name: _optional(samples, name) for name in COLUMNS}
    measured = {name: values[:stop] for name, values in read.items() if values is not None}
    others = {str(name) for sample in samples for name in sample.content} - {*SAMPLE, *measured}
    unknown = [str(name) for name in top.content if name not in TOP]
    unknown += [f"entries.{name}" for name in sorted(others - set(COLUMNS))]
    metadata: dict[str, Any] = {ours: top.text(n) for n, ours in TEXTS.items() if n in top}
    metadata |= {ours: top.number(name) for name, ours in NUMBERS.items() if name in top}
    metadata |= {"original_file": Path(path).name, "not_imported": sorted(others)}
    if unknown:
        sentence = f"Unknown fields of the log are not read: {', '.join(unknown)}."
        metadata |= import_warnings([sentence])
    if off < stop:
        metadata["torque_off_from_s"] = float(t[off])
    if stop < t.size:
        why = "the torque comes on again"
        metadata["left_out"] = {"from_s": float(t[stop]), "rows": t.size - stop, "why": why}
    return Recording(
        name=Path(path).stem,
        kind="servo",
        joints=("j1",),
        t=t[:stop],
        command=np.array(command + [math.nan] * (stop - off))[:, None],
        position=np.array(position[:stop])[:, None],
        loads={"j1": load},
        source=source,
        columns={COLUMNS[name]: values for name, values in measured.items()},
        metadata=metadata,
    )


def _top(path: str | os.PathLike[str]) -> Fields:
    """The fields of a log, with the known names that BAM's recorders write with a hyphen."""
    content = read_json(path)
    for name in [name for name in content if "-" in name]:
        ours = name.replace("-", "_")
        if ours in TOP:
            value = content.pop(name)
            if content.setdefault(ours, value) != value:
                expected = f"the value of {ours}, {shown(content[ours])}"
                raise InputError(path, name, shown(value), expected)
    return Fields(path, "", content)


def _load(top: Fields) -> tuple[Load, str]:
    """The load of BAM's bench, a point mass at the end of a uniform rod, and what the log is."""
    mass, arm = top.number("mass", low=0), top.number("arm_mass", 0.0, low=0)
    length = top.number("length", above=0)
    if mass + arm <= 0:
        raise top.error("mass", "a mass above 0, or an arm_mass")
    load = "inertia_kgm2 is mass*length^2: arm and rotor are not in it."
    if arm > 0:
        load = "inertia_kgm2 is mass*length^2 + arm_mass*length^2/3, without the rotor; the point "
        load += "mass mass + arm_mass/2 at that length has the gravity torque of weight and arm."
    source = (
        "Log in the format of Rhoban's BAM, Better Actuator Models (github.com/Rhoban/bam); "
        f"licence not stated in the log. {load} Position 0 is taken to hang straight down. A "
        "set-point left a few milliseconds, how many was not logged, before its t_s."
    )
    return Load((mass + arm / 3) * length**2, mass + arm / 2, length), source


def _torque(samples: list[Fields]) -> tuple[int, int]:
    """Index of the first sample with the torque off, and of the first with it on again."""
    enabled = [sample.content.get("torque_enable") for sample in samples]
    for sample, on in zip(samples, enabled, strict=True):
        if not isinstance(on, bool):
            raise sample.error("torque_enable", "true or false")
    if not enabled[0]:
        raise samples[0].error("torque_enable", "true: a recording starts on its first command")
    off = enabled.index(False) if False in enabled else len(enabled)
    return off, enabled.index(True, off) if True in enabled[off:] else len(enabled)


def _angle(sample: Fields, name: str) -> float:
    angle = sample.number(name)
    if abs(angle) > LARGEST_ANGLE_RAD:
        raise sample.error(name, f"radians within {LARGEST_ANGLE_RAD:.1f} (degrees, perhaps?)")
    return angle


def _optional(samples: list[Fields], name: str) -> Array | None:
    """Values of an optional field, shape (T,), NaN where missing; None if it was not measured."""
    present = np.array([sample.content.get(name) is not None for sample in samples])
    values = np.full(present.size, np.nan)
    values[present] = [samples[k].number(name) for k in np.flatnonzero(present)]
    if not np.nan_to_num(values).any():
        return None
    negative = values >= 2**15
    if name != "load" or not negative.any():
        return values
    # The XL330's recorder logs a signed 16-bit register as unsigned: -1 is logged as 65535.
    # Resampling interpolates between 0 and 65535, which cannot be undone.
    return None if (values[present] % 1).any() else np.where(negative, values - 2**16, values)


ACTUATORS = Path(__file__).parent / "bam_actuators.json"
"""Supply, firmware gain and its scale, and limits of BAM's servos, from its programs."""

_STRIBECK = ("friction_stribeck", "dtheta_stribeck", "alpha")
_LOAD = ("load_friction_motor", "load_friction_external")
_M5 = (*_STRIBECK, *_LOAD, *(f"{name}_stribeck" for name in _LOAD))
_QUADRATIC = tuple(f"{name}_quad" for name in _LOAD)
_REQUIRED: dict[str, tuple[str, ...]] = {
    "m1": (),
    "m2": _STRIBECK,
    "m3": ("load_friction_base",),
    "m4": (*_STRIBECK, "load_friction_base", "load_friction_stribeck"),
    "m5": _M5,
    "m6": (*_M5, *_QUADRATIC),
}
_OPTIONAL = ("q_offset", "error_gain_ratio", "max_velocity", "command_delay")


def is_bam_parameters(content: dict[str, Any]) -> bool:
    """Whether a JSON object is a parameter file of BAM."""
    return {"kt", "actuator", "model"} <= content.keys()


def read_bam_parameters(path: str | os.PathLike[str], load: Load) -> Model:
    """A model of the joint ``j1`` from a parameter file of BAM (``bam/params/SERVO/M1.json``, ...).

    Notes of the joint state what the model cannot express.

    Args:
        path: The file.
        load: Load on the output shaft. A parameter file states none.

    Returns:
        The model. BAM gives no intervals; ``provenance["servo"]`` has the gain of the firmware and
        the supply in V of BAM's program.

    Raises:
        InputError: If a field is missing or invalid, or the servo is not controlled by a voltage.
    """
    fields = Fields(path, "", read_json(path))
    friction, actuator = fields.text("model"), fields.text("actuator")
    if friction not in _REQUIRED:
        raise fields.error("model", one_of(friction, list(_REQUIRED)))
    table = Fields(ACTUATORS, "", read_json(ACTUATORS)).table("actuators")
    if actuator not in table:
        raise fields.error("actuator", one_of(actuator, list(table.content)))
    bench = table.table(actuator)  # what BAM's program states of the servo
    positive = ("kt", "R", *(_STRIBECK[1:] if "alpha" in _REQUIRED[friction] else ()))
    values = {name: fields.number(name, above=0) for name in positive}
    for name in ("armature", "friction_base", "friction_viscous", *_REQUIRED[friction]):
        values[name] = fields.number(name, low=0)
    values |= {name: fields.number(name) for name in _OPTIONAL if name in fields}
    gain, volts = bench.number("firmware_gain"), bench.number("supply_V")
    per_volt = values["kt"] / values["R"]
    scale = bench.number("duty_per_gain_rad") * values.get("error_gain_ratio", 1.0)
    kd = values["kt"] * per_volt + values["friction_viscous"]
    stall = per_volt * volts * bench.number("largest_duty")
    both = values.get("load_friction_base", 0.0), values.get("load_friction_stribeck", 0.0)
    motor = {
        "stall_torque_Nm": stall,
        "no_load_speed_rad_s": stall / kd,
        "rotor_inertia_kgm2": values["armature"],
        "coulomb_Nm": 0.0 if "friction_stribeck" in values else values["friction_base"],
        "motor_friction": values.get("load_friction_motor", both[0]),
        "load_friction": values.get("load_friction_external", both[0]),
        # M4 multiplies the Stribeck part by the same torque as the other part.
        "stribeck_motor_friction": values.get("load_friction_motor_stribeck", both[1]),
        "stribeck_load_friction": values.get("load_friction_external_stribeck", both[1]),
        "stribeck_speed_rad_s": _stribeck_speed(values),
    }
    model = JointModel(
        kp_Nm_per_rad=per_volt * volts * gain * scale,
        kd_Nms_per_rad=kd,
        latency_s=values.get("command_delay", 0.0),
        inertia_kgm2=load.inertia_kgm2,
        load=load,
        law="motor",
        motor={name: value for name, value in motor.items() if value > 0},
        effects=_effects(values, bench, kd),
        notes=_not_mapped(fields, values),
    )
    return Model({"j1": model}, provenance={"servo": {"firmware_gain": gain, "supply_V": volts}})


def _stribeck_speed(values: dict[str, float]) -> float:
    """Speed of exp(-(v / speed)^2) with the same area as exp(-|v / dtheta|^alpha), rad/s."""
    if "alpha" not in values:
        return 0.0
    area = values["dtheta_stribeck"] * math.gamma(1 + 1 / values["alpha"])
    return area / math.gamma(1.5)


def _effects(values: dict[str, float], bench: Fields, kd: float) -> tuple[FittedEffect, ...]:
    effects: dict[str, dict[str, float]] = {}
    if "friction_stribeck" in values:
        sliding = values["friction_base"]
        effects["stribeck_friction"] = {
            "torque_Nm": sliding,
            "breakaway_Nm": sliding + values["friction_stribeck"],
            "velocity_rad_s": _stribeck_speed(values),
        }
    current = bench.optional_number("largest_current_A")
    if current is not None:
        # The limit is of the motor, so viscous friction, which is part of kd, acts beyond it.
        beyond = values["friction_viscous"] / kd
        effects["torque_saturation"] = {"limit_Nm": values["kt"] * current, "free_damping": beyond}
    speed = values.get("max_velocity", bench.optional_number("largest_speed_rad_s"))
    if speed is not None:
        effects["rate_limit"] = {"limit_rad_s": speed}
    return tuple(FittedEffect(name, parameters) for name, parameters in effects.items())


def _not_mapped(fields: Fields, values: dict[str, float]) -> tuple[str, ...]:
    """One sentence for each field that the model does not express."""
    notes = []
    if "alpha" in values and abs(values["alpha"] - 2) > 0.01:
        notes.append(
            f"alpha = {values['alpha']:.3g}: the exponent of the Stribeck part is 2 here, its "
            "speed is chosen such that the area under the curve is the same"
        )
    for name in _QUADRATIC:
        if values.get(name, 0.0) > 0:
            why = "friction that grows with the square of the torque has no counterpart"
            notes.append(f"{name} = {values[name]:.3g}: not mapped, {why}")
    if offset := values.get("q_offset"):
        notes.append(f"q_offset = {offset:.3g} rad: not mapped, it belongs to BAM's bench")
    known = {*values, "model", "actuator"}
    for name, value in fields.content.items():
        if name not in known:
            number = finite_number(value)
            text = shown(value) if number is None else f"{number:.6g}"
            notes.append(f"{name} = {text}: not mapped, an unknown field")
    return tuple(notes)
