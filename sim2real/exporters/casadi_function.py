"""The servo as a smooth ``casadi.Function`` for optimal control, saved and as C.

The scheme is that of ``servo.law``: forces in the middle, damping by the trapezoidal rule, friction
as an impulse that can stop the shaft. Limits and friction are rounded off: with a width w of
``smoothing`` times the limit m, ``clip(x) = (sqrt((x + m)^2 + w^2) - sqrt((x - m)^2 + w^2)) / 2``
differs from the sharp one by at most w / 2 and has all derivatives.
"""

import math
import re
from collections.abc import Sequence
from typing import Any

from sim2real.errors import library
from sim2real.exporters.actuator import SATURATION, Actuator, LeftOut, comment, head
from sim2real.robot import Robot

Function = Any
Symbol = Any
"""Types of CasADi, which has no stubs."""
HAS = (
    "coulomb_friction", "asymmetric_friction", "stribeck_friction", "load_friction",
    "unmodelled_inertia", "gravity_load", "quadratic_drag", "deadband", "rate_limit",
    "command_filter", SATURATION, "motor.resistance_rise", "motor.motor_friction",
    "motor.load_friction", "motor.stribeck_motor_friction", "motor.stribeck_load_friction",
    "motor.stribeck_speed_rad_s", "motor.stick_time_s", "motor.creep_time_s",
)  # fmt: skip
"""Effects and losses of the motor that the function has."""


def casadi_text(servos: Sequence[Actuator], _: Robot | None, __: Sequence[LeftOut]) -> str:
    """The functions of all joints, one after the other, as ``casadi.FileDeserializer`` reads."""
    serializer = library("casadi", "--to casadi").StringSerializer()
    for function in _functions(servos):
        serializer.pack(function)
    return str(serializer.encode())


def casadi_c_text(servos: Sequence[Actuator], _: Robot | None, lines: Sequence[LeftOut]) -> str:
    """C code of the functions and of their Jacobians, below their inputs and what they lack."""
    generator = library("casadi", "--to casadi").CodeGenerator("servo.c")
    said = head(lines)
    for function in _functions(servos):
        generator.add(function)
        generator.add(function.jacobian())
        said += ["", f"{function.name()}, inputs in this order (with the identified values):"]
        for k in range(function.n_in()):
            default = f" ({function.default_in(k):.9g})" if k > 1 else ""
            said.append(f"  {function.name_in(k)}{default}")
    return comment(said, "// ") + str(generator.dump())


def _functions(servos: Sequence[Actuator]) -> list[Function]:
    """``servo_JOINT`` of each joint; further ones of one name end in their number."""
    functions: dict[str, Function] = {}
    for k, servo in enumerate(servos, 1):
        name = f"servo_{_identifier(servo.joint)}".rstrip("_")
        name = f"{name}_{k}" if name in functions else name
        functions[name] = servo_function(servo, name)
    return list(functions.values())


def servo_function(servo: Actuator, name: str = "servo") -> Function:
    """State of a servo after ``duration_s``, 10 ms by default, as a ``casadi.Function``.

    Inputs are ``state``, ``set_point`` in rad in force (sent the latency ago), ``duration_s``,
    ``smoothing`` and the servo's parameters, with their identified values as defaults. The state is
    angle in rad and speed in rad/s, and an internal set-point in rad for each of ``rate_limit`` and
    ``command_filter``. Durations up to 10 ms are as accurate as a prediction.
    """
    ca, longest_s = library("casadi", "--to casadi"), 0.01
    effects = {k: v for k, v in servo.effects.items() if k in HAS and k != "unmodelled_inertia"}
    every = {
        "kp_Nm_per_rad": servo.kp,
        "kd_Nms_per_rad": servo.kd,
        "inertia_kgm2": servo.inertia + servo.beyond_load,
        "gravity_Nm": servo.gravity,
        "limit_Nm": servo.limit or 0.0,
        "back_emf_Nms_per_rad": servo.back_emf,
        **{f"{effect}.{name}": x for effect, given in effects.items() for name, x in given.items()},
        **{f"motor.{name}": x for name, x in servo.motor.items() if f"motor.{name}" in HAS},
    }
    values = {key: x for key, x in every.items() if x or key.startswith("k")}
    names = [_identifier(key) for key in values]
    symbols = dict(zip(values, map(ca.SX.sym, names), strict=True))
    cells = [effect for effect in ("rate_limit", "command_filter") if effect in servo.effects]
    state, fixed = ca.SX.sym("state", 2 + len(cells)), ca.SX.sym("fixed", 3)
    smooth = _SmoothServo(ca, symbols, fixed[2])
    after = smooth.substep(state, fixed[0], fixed[1], cells)
    substep = ca.Function("substep", [state, ca.vertcat(fixed, *symbols.values())], [after])
    fastest = max(math.sqrt(abs(servo.kp) / values["inertia_kgm2"]), 1e-9)
    fastest = max(fastest, 0.5 * (servo.kd + servo.back_emf) / values["inertia_kgm2"])
    steps = min(max(math.ceil(64 * fastest * longest_s), 5), math.ceil(longest_s / 2e-5))
    start, u, duration = ca.MX.sym("state", state.numel()), ca.MX.sym("u"), ca.MX.sym("h")
    rounding, inputs = ca.MX.sym("w"), [ca.MX.sym(key) for key in names]
    held = ca.vertcat(u, duration / steps, rounding, *inputs)
    end = substep.fold(steps)(start, ca.repmat(held, 1, steps))
    return ca.Function(
        name,
        [start, u, duration, rounding, *inputs],
        [end],
        ["state", "set_point", "duration_s", "smoothing", *names],
        ["next_state"],
        {"default_in": [0.0, 0.0, longest_s, 1e-3, *values.values()]},
    )


def _identifier(name: str) -> str:
    """A name as C and CasADi take it."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")


class _SmoothServo:
    """The law in CasADi's symbols ``p``; ``width`` is the relative width of roundings."""

    def __init__(self, ca: Symbol, p: dict[str, Symbol], width: Symbol) -> None:
        self.ca, self.p, self.width = ca, p, width

    def __getitem__(self, name: str) -> Symbol:
        return self.p.get(name, 0.0)

    def substep(self, state: Symbol, u: Symbol, h: Symbol, cells: Sequence[str]) -> Symbol:
        """The state after h."""
        place, kept = state[0] + 0.5 * h * state[1], []
        for k, effect in enumerate(cells, 2):
            u, memory = self.internal(effect, u, state[k], h)
            kept.append(memory)
        error = self.seen(u - place)
        v, speed = state[1], state[1]
        by_speed = re.compile("motor|quadratic|stribeck|load_friction")
        for _ in range(1 + any(map(by_speed.match, self.p))):  # it is first that at the start
            angle, after = self.moved(state[0], v, speed, place, error, h)
            speed = 0.5 * (v + after)
        return self.ca.vertcat(angle, after, *kept)

    def internal(self, effect: str, u: Symbol, cell: Symbol, h: Symbol) -> tuple[Symbol, Symbol]:
        """Mean over h of the internal set-point, and its value at the end."""
        if effect == "command_filter":
            tau = self["command_filter.time_constant_s"]
            gap, remaining = cell - u, self.ca.exp(-h / tau)
            return u + gap * (1 - remaining) * tau / h, u + gap * remaining
        most = self["rate_limit.limit_rad_s"] * h
        move = self.clip(u - cell, most)
        return cell + move - 0.5 * move * self.size(move, most) / most, cell + move

    def seen(self, error: Symbol) -> Symbol:
        """The error beyond the dead band."""
        band = self["deadband.halfwidth_rad"]
        if isinstance(band, float):
            return error
        beyond = error - self.clip(error, band)
        return beyond + self["deadband.step_share"] * band * beyond / self.size(beyond, band)

    def moved(
        self, q: Symbol, v: Symbol, speed: Symbol, place: Symbol, error: Symbol, h: Symbol
    ) -> tuple[Symbol, Symbol]:
        """Angle and speed after h; ``speed`` is that in the middle, ``place`` the angle there."""
        weight = -self["gravity_Nm"] * self.ca.sin(place)
        load = weight - self["gravity_load.torque_Nm"] * self.ca.sin(place)
        load -= self["quadratic_drag.coefficient_Nms2"] * speed * self.size(speed, 1)
        impulse = h / self["inertia_kgm2"]

        def free(push: Symbol, damping: Symbol) -> Symbol:
            damp = 0.5 * impulse * damping
            return ((1 - damp) * v + impulse * (push + load)) / (1 + damp)

        def limited(
            push: Symbol, damping: Symbol, limit: Symbol, beyond: Symbol
        ) -> tuple[Symbol, Symbol]:
            """Torque and damping, with a limit to all but the damping ``beyond``: its tangent."""
            middle, inside = 0.5 * (v + free(push, damping)), damping - beyond
            wanted = push - inside * middle
            steep = self.slope(wanted, limit) * inside
            return self.clip(wanted, limit) + steep * middle, beyond + steep

        back_emf = self["back_emf_Nms_per_rad"]
        push, damping = self["kp_Nm_per_rad"] * error, self["kd_Nms_per_rad"] + back_emf
        if "limit_Nm" in self.p:
            push, damping = limited(push, damping, self["limit_Nm"], back_emf)
            rise = self["motor.resistance_rise"] / self["limit_Nm"]
            drawn = self.size(push - damping * speed, self["limit_Nm"])
            weaker = 0.5 + self.ca.sqrt(0.25 + rise * drawn)
            push, damping = push / weaker, damping / weaker
        if f"{SATURATION}.limit_Nm" in self.p:
            beyond = self[f"{SATURATION}.free_damping"] * (self["kd_Nms_per_rad"] + back_emf)
            push, damping = limited(push, damping, self[f"{SATURATION}.limit_Nm"], beyond)
        without = free(push, damping)
        impending = 0.5 * (v + without)  # of a shaft at rest as well
        bound = self.friction(speed, push - damping * speed, weight, impending)
        if isinstance(bound, float):
            return q + 0.5 * h * (v + without), without
        stop = impulse * bound / (1 + 0.5 * impulse * damping)
        stick, creep = self["motor.stick_time_s"], self["motor.creep_time_s"]
        if not isinstance(stick + creep, float):
            creeping = creep * (without - v) / h
            aim = creeping + (v - creeping) * self.ca.exp(-h / (stick + creep))
            after = without - self.clip(without - aim, stop)
            return q + 0.5 * h * (v + after), after
        return self.slid(q, v, without, stop, h)

    def friction(self, v: Symbol, torque: Symbol, weight: Symbol, impending: Symbol) -> Symbol:
        """Largest torque of dry friction."""
        exp, p, scale = self.ca.exp, self.p, 0.02 * self["kp_Nm_per_rad"]
        bound = self["coulomb_friction.torque_Nm"]
        if "asymmetric_friction.torque_Nm" in p:
            way = self["asymmetric_friction.asymmetry"] * impending / self.size(impending, 0.1)
            bound += self["asymmetric_friction.torque_Nm"] * (1 + way)
        if "stribeck_friction.velocity_rad_s" in p:
            slow = exp(-((v / self["stribeck_friction.velocity_rad_s"]) ** 2))
            sliding = self["stribeck_friction.torque_Nm"]
            bound += sliding + (self["stribeck_friction.breakaway_Nm"] - sliding) * slow
        elif "stribeck_friction.torque_Nm" in p:
            bound += self["stribeck_friction.torque_Nm"]
        if "load_friction.ratio" in p:
            fading = exp(-((v * self["load_friction.fading_s_per_rad"]) ** 2))
            bound += self["load_friction.ratio"] * fading * self.size(torque, scale)
        for slow in ("", "stribeck_"):
            names = [f"motor.{slow}{part}_friction" for part in ("motor", "load")]
            if any(name in p for name in names):
                fading = exp(-((v / self["motor.stribeck_speed_rad_s"]) ** 2)) if slow else 1.0
                loaded = self[names[0]] * torque - self[names[1]] * weight
                bound += fading * self.size(loaded, scale)
        return bound

    def slid(
        self, q: Symbol, v: Symbol, free: Symbol, stop: Symbol, h: Symbol
    ) -> tuple[Symbol, Symbol]:
        """As ``servo.motor.slide``: friction brakes until the shaft stands, then holds it."""
        size, change = self.size(v, stop), free - v
        sign = v / size
        braking, size = stop - change * sign, v * sign
        longer = 0.5 * (braking + size + self.size(braking - size, stop))
        moving = size / longer  # share of h
        stands = v + moving * (change - sign * stop)
        pushed = stands + (1 - moving) * change
        after = pushed - self.clip(pushed, (1 - moving) * stop)
        angle = q + 0.5 * h * (moving * (v + stands) + (1 - moving) * (stands + after))
        return angle, after

    def size(self, x: Symbol, scale: Symbol) -> Symbol:
        """Absolute value, rounded off."""
        return self.ca.sqrt(x * x + (self.width * scale) ** 2 + 1e-24)

    def clip(self, x: Symbol, most: Symbol) -> Symbol:
        """A number limited to ``most``, rounded off."""
        return 0.5 * (self.size(x + most, most) - self.size(x - most, most))

    def slope(self, x: Symbol, most: Symbol) -> Symbol:
        """Derivative of ``clip``."""
        above, below = x + most, x - most
        return 0.5 * (above / self.size(above, most) - below / self.size(below, most))
