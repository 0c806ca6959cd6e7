"""Units and readable names of parameters, from their names in files.

A name ends with its unit (``kp_Nm_per_rad``); a name without unit is that of a pure number.
"""

import math

_DEGREES = 180 / math.pi
_UNITS = (
    ("_rad_per_Nm", "rad/(N m)", "° per N m", _DEGREES),
    ("_Nm_per_rad_s", "N m/(rad s)", " N m/(rad s)", 1.0),
    ("_Nms_per_rad", "N m s/rad", " N m s/rad", 1.0),
    ("_Nm_per_rad", "N m/rad", " N m/rad", 1.0),
    ("_N_per_m", "N/m", " N/m", 1.0),
    ("_rad_s2", "rad/s²", " rad/s²", 1.0),
    ("_rad_s", "rad/s", " rad/s", 1.0),
    ("_rad", "rad", "°", _DEGREES),
    ("_Nms2", "N m s²", " N m s²", 1.0),
    ("_Nm", "N m", " N m", 1.0),
    ("_kgm2", "kg m²", " kg m²", 1.0),
    ("_m2_s", "m²/s", " m²/s", 1.0),
    ("_m2", "m²", " cm²", 1e4),
    ("_m_s", "m/s", " m/s", 1.0),
    ("s_per_s", "s/s", " ppm", 1e6),
    ("_per_min", "1/min", " % per minute", 100.0),
    ("_s", "s", " ms", 1e3),
    ("_m", "m", " mm", 1e3),
)
"""Ending of the name, unit in files, unit in sentences, and factor from the first to the second."""
_PER_INERTIA = {"N m/rad": "1/s²", "N m s/rad": "1/s", "N m": "1/s²", "kg m²": ""}
"""Units of models with an unknown load: torques are per unit of inertia."""
_NAMES = {
    "kp_Nm_per_rad": "kp",
    "kd_Nms_per_rad": "kd",
    "unmodelled_inertia.inertia_kgm2": "unmodelled inertia",
    "motor.no_load_speed_rad_s": "no-load speed",
    "motor.coulomb_Nm": "Coulomb friction",
    "motor.stribeck_motor_friction": "Stribeck, motor",
    "motor.stribeck_load_friction": "Stribeck, load",
    "motor.stribeck_speed_rad_s": "Stribeck speed",
    "s_per_s": "drift",
}
"""Readable names that are not derived from the parameter's name."""
_SMALL_NM = 0.01
"""Torque in N m below which it is stated in mN m."""
_WRITTEN_OUT = 1e6
"""Value below which numbers are written without exponent."""


_PLAUSIBLE = (
    ("sample_delay_s", 0.0, 1.0),
    ("_kgm2", 1e-12, 1e9),
    ("_kg", 1e-9, 1e6),
    ("_per_s", 0.0, 1e6),
    ("_rad_s", 0.0, 1e6),
    ("_m_s", 0.0, 1e6),
    ("t_s", 0.0, 1e10),
    ("_s", 0.0, 1e4),
    *((ending, 0.0, 1e9) for ending in ("_Nm_per_rad", "_Nms_per_rad", "_rad_s2", "_N", "_Nm")),
    *((ending, 0.0, 1e6) for ending in ("_rad", "_m", "_m2", "_m_s2", "_V", "_A", "_C", "_hz")),
)
"""Ending of the name, and the smallest and largest size of a value, SI, that is no mistake."""


def plausible(name: str) -> tuple[float, float, str]:
    """Smallest size above 0, and largest, of a value for robots of 1 g to 1000 t, and its unit."""
    for ending, smallest, largest in _PLAUSIBLE:
        if name.endswith(ending):
            return smallest, largest, _unit(name)[1] or ending[1:]
    return 0.0, math.inf, ""


def unit_of(name: str, *, per_inertia: bool = False) -> str:
    """SI unit of a parameter, or of a torque per unit of inertia; empty for a pure number."""
    unit = _unit(name)[1]
    return _PER_INERTIA.get(unit, unit) if per_inertia else unit


def readable(name: str, value: float, *, per_inertia: bool = False) -> str:
    """A parameter's SI value with a unit for sentences: ``"1.7°"``, ``"30 ms"``, ``"12 %"``."""
    _, _, unit, size = _unit(name)
    if unit == " N m" and abs(value) < _SMALL_NM:
        unit, size = " mN m", 1e3
    if per_inertia:
        unit = unit.replace("N m", "N m/(kg m²)", 1)
    return f"{three_digits(value * size)}{unit}"


def three_digits(value: float) -> str:
    """A number to three significant digits, without an exponent below a million."""
    text = f"{value:.3g}"
    return f"{float(text):.0f}" if 1000 <= abs(float(text)) < _WRITTEN_OUT else text


def readable_name(name: str) -> str:
    """A parameter's name without its unit: ``"kp"``, ``"stall torque"``, ``"backlash gap"``."""
    if name in _NAMES:
        return _NAMES[name]
    bare = name.removesuffix(_unit(name)[0]).removeprefix("motor.")
    return bare.replace(".", " ").replace("_", " ")


def _unit(name: str) -> tuple[str, str, str, float]:
    """The entry of ``_UNITS`` for a parameter; a share in % if it is a pure number."""
    return next((entry for entry in _UNITS if name.endswith(entry[0])), ("", "", " %", 100.0))
