"""Values for display, scaled and rounded, with unit and interval; rows of them as a table."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from sim2real.inference.normal import LEVEL
from sim2real.model import FittedEffect, JointModel
from sim2real.report.page import Table
from sim2real.units import readable_name, unit_of


@dataclass(frozen=True)
class Quantity:
    """One value with its interval, in the unit of the display."""

    name: str  # such as ``"kp"``
    unit: str  # such as ``"N m/rad"``
    value: float
    interval: tuple[float, float] | None = None
    """With an infinite end where the data do not constrain the value; None if not estimated."""
    origin: str = ""  # of a value without an interval

    @property
    def texts(self) -> tuple[str, str, str]:
        """Value, lower and upper end with the same rounding; empty ends without an interval."""
        if self.interval is None:
            return f"{self.value:.4g}", "", ""
        places = _decimal_places(self.value, self.interval)
        value, low, high = (
            f"{x:.3g}" if abs(x) >= 1e6 else f"{x:.{places}f}" for x in (self.value, *self.interval)
        )
        return value, low, high

    @property
    def between(self) -> str:
        """The interval; an empty string where there is none."""
        _, low, high = self.texts
        if self.interval is None:
            return ""
        below, above = map(math.isinf, self.interval)
        if below or above:
            return "no bound" if below and above else f"above {low}" if above else f"below {high}"
        return f"{low} to {high}"

    @property
    def remark(self) -> str:
        """Half the width of the interval in percent of the value, or where the value is from."""
        if self.interval is None or any(map(math.isinf, self.interval)) or not self.value:
            return self.origin
        percent = 50 * (self.interval[1] - self.interval[0]) / abs(self.value)
        if percent >= 1000:
            return "over ± 1000 %"
        return f"± {percent:.2g} %" if percent < 100 else f"± {percent:.0f} %"


def quantity_table(
    rows: Iterable[tuple[str, Quantity]],
    place: str = "joint",
    caption: str = "",
    *,
    level: float = LEVEL,
) -> Table:
    """A table of quantities, each with the name of what it belongs to, such as a joint."""
    cells = [(where, q.name, q.texts[0], q.unit, q.between, q.remark) for where, q in rows]
    header = (place, "parameter", "value", "unit", f"{100 * level:g} % interval", "")
    return Table(header, cells, caption)


def quantities(joint: JointModel) -> tuple[Quantity, ...]:
    """kp, kd, latency and inertia of ``joint`` and the parameters of its motor."""
    per = joint.per_inertia

    def fitted(key: str, value: float, unit: str = "", scale: float = 1.0) -> Quantity:
        ends = joint.interval.get(key)
        interval = None if ends is None else (scale * ends[0], scale * ends[1])
        unit = unit or unit_of(key.removeprefix("motor."), per_inertia=per)
        origin = "" if interval else "no interval"
        return Quantity(readable_name(key), unit, scale * value, interval, origin)

    inertia = fitted("inertia_kgm2", joint.inertia_kgm2, "kg m²")
    if inertia.interval is None:
        origin = "per unit of inertia" if per else "stated" if joint.load else "given"
        inertia = Quantity("inertia", "kg m²", joint.inertia_kgm2, None, origin)
    return (
        fitted("kp_Nm_per_rad", joint.kp_Nm_per_rad),
        fitted("kd_Nms_per_rad", joint.kd_Nms_per_rad),
        fitted("latency_s", joint.latency_s, "ms", 1e3),
        inertia,
        *(fitted(f"motor.{key}", value) for key, value in joint.motor.items()),
    )


def effect_text(
    effect: FittedEffect, intervals: Mapping[str, tuple[float, float]] | None = None
) -> str:
    """An effect on one line: ``backlash (gap_rad 0.03, 0.027 to 0.033)``."""
    parameters = []
    for name, value in effect.parameters.items():
        ends = (intervals or {}).get(f"{effect.effect}.{name}")
        between = f", {ends[0]:.3g} to {ends[1]:.3g}" if ends else ""
        parameters.append(f"{name} {value:.4g}{between}")
    return f"{effect.effect} ({'; '.join(parameters)})" if parameters else effect.effect


def change_text(before: float, after: float) -> str:
    """Relative change of a number: ``"-52 %"``, ``"+120 %"``; a dash if it was not positive."""
    if not before > 0:
        return "-"
    percent = round(100 * (after / before - 1))
    return f"{percent:+d} %" if percent else "0 %"


def milliradians(angle_rad: float | None) -> str:
    """An angle as ``"4.1 mrad"``; a dash for None or a number that is not finite."""
    if angle_rad is None or not math.isfinite(angle_rad):
        return "-"
    angle = 1e3 * angle_rad
    return f"{angle:.1f} mrad" if abs(angle) >= 1 else f"{angle:.2g} mrad"


def _decimal_places(value: float, ends: tuple[float, float]) -> int:
    """Places for two digits of the narrower side of the interval, and of the value.

    At most three digits of an interval that is wide beside these.
    """
    sizes = [abs(value) / 10, *(abs(end - value) for end in ends)]
    sizes = [size for size in sizes if math.isfinite(size) and size > 0]
    width = ends[1] - ends[0]
    least = width / 20 if math.isfinite(width) else 0.0
    if not sizes:
        return 3
    return max(0, min(9, 1 - math.floor(math.log10(max(min(sizes), least)))))
