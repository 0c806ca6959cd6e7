"""``sim2real scan`` and ``sim2real virtual-servo``: servos on a bus, real and simulated."""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
from tqdm import tqdm

from sim2real.errors import InputError, one_of
from sim2real.hardware.buses import Bus, bus_class, connection, ids_of
from sim2real.hardware.radio import shared_key
from sim2real.hardware.recorder import interruption, priority
from sim2real.hardware.registers import model_named, servo_models
from sim2real.hardware.servo_bus import Found
from sim2real.hardware.virtual_bus import Law, VirtualBus, VirtualServo, serve_terminal, serve_udp
from sim2real.hardware.virtual_servos import VirtualDynamixel, VirtualFeetech, VirtualLx
from sim2real.model import read_model

LOCAL_S, NETWORK_S = 0.01, 0.05  # delay of an adapter or a radio
EXCHANGE_BITS = 32 * 10  # a request and its reply on the wire
_WITH_MODELS = {
    "dynamixel": ("XL330-M288", VirtualDynamixel),
    "feetech": ("STS3215", VirtualFeetech),
}
"""Usual model and simulated servo of the buses with models."""


def scan(options: argparse.Namespace) -> int:
    """Print a table of the servos that answer; 0 if one did, 1 if none."""
    kind = bus_class(options.bus)
    ids = ids_of(options.ids, kind)
    network = "://" in options.port
    rates = kind.baud_rates[: 1 if network else None] if options.baud is None else (options.baud,)
    for baud in rates:
        patience = (NETWORK_S if network else LOCAL_S) + EXCHANGE_BITS / baud
        with connection(options.bus, options.port, baud) as link:
            try:
                bar = tqdm(ids, desc=f"{baud} baud", unit="id", disable=None)
                servos, garbled = scanned(link.bus, bar, patience)
            except OSError as error:
                reason = error.strerror or error
                print(f"sim2real scan: the port was lost ({reason})", file=sys.stderr)
                return 1
        for servo_id in garbled:
            print(f"id {servo_id}: a corrupted answer, possibly of two servos with this id")
        if servos:
            options.result = servos
            print(table(servos))
            if baud != kind.baud_rates[0] and options.baud is None:
                advice = "pass it as --baud to other commands"
                if options.bus == "lx":
                    advice = "switch their supply off and on again"
                print(f"They answer at {baud} baud: {advice}.")
            return 0
    tried = f"{options.port} ({options.bus}, {', '.join(map(str, rates))} baud)"
    advice = "check supply, --bus, --baud and --ids"
    print(f"sim2real scan: no servo answers on {tried}: {advice}", file=sys.stderr)
    return 1


def scanned(
    bus: Bus, ids: Iterable[int], patience_s: float, *, attempts: int = 3
) -> tuple[list[Found], list[int]]:
    """Servos that answer, and identities with corrupted answers; nothing is written to them."""
    servos, garbled = [], []
    for servo_id in ids:
        before = bus.garbled
        if any(bus.answers(servo_id, patience_s) for _ in range(attempts)):
            servos.append(bus.look(servo_id, patience_s))
        elif bus.garbled > before:
            garbled.append(servo_id)
    return servos, garbled


def table(servos: Sequence[Found]) -> str:
    """The servos as a table, one line each."""
    width = max(len(servo.model) for servo in servos)
    width = max(width, len("model")) if width else 0
    named = f" {'model':<{width}}" if width else ""
    lines = [f"{'id':>3}{named} {'ticks':>6} {'rad':>7} {'supply':>8} {'temp':>5}  torque  errors"]
    for servo in servos:
        ticks = "-" if servo.ticks is None else f"{servo.ticks}"
        angle = "-" if servo.angle_rad is None else f"{servo.angle_rad:+.3f}"
        supply = "-" if servo.supply_V is None else f"{servo.supply_V:.2f} V"
        temperature = "-" if servo.temperature_C is None else f"{servo.temperature_C} C"
        torque = "-" if servo.powered is None else "on" if servo.powered else "off"
        errors = ", ".join(servo.errors) or "none"
        named = f" {servo.model:<{width}}" if width else ""
        lines.append(
            f"{servo.servo_id:>3}{named} {ticks:>6} {angle:>7} {supply:>8} {temperature:>5}  "
            f"{torque:<6}  {errors}"
        )
    return "\n".join(lines)


def virtual_servo(options: argparse.Namespace) -> int:
    """Simulate servos on a bus until Ctrl-C; the first line printed is the port."""
    kind = bus_class(options.bus)
    for name in ("loss", "noise"):
        share = getattr(options, name)
        if not 0 <= share < 1:
            raise InputError(f"--{name}", "", f"{share:g}", "a share from 0 up to 1")
    ids = ids_of(options.ids, kind)
    baud = kind.baud_rates[0] if options.baud is None else options.baud
    if baud <= 0:
        raise InputError("--baud", "", f"{baud}", "a rate above 0, such as 1000000")
    make = _maker(options)
    now = time.monotonic()
    names = {"supply_V": "supply", "temperature_C": "temperature", "heating_C_per_s": "heating"}
    health = {name: getattr(options, option) for name, option in names.items()}
    laws = zip(ids, _laws(options, len(ids)), strict=True)
    servos = [make(servo_id, law, now, **health) for servo_id, law in laws]
    rng = np.random.default_rng(options.seed)
    wire = {name: getattr(options, name) for name in ("noise", "echo", "fast")}
    loss = 0.0 if options.udp else options.loss
    bus = VirtualBus(servos, kind.protocol, rng, loss=loss, baud=baud, **wire)

    def announce(port: str) -> None:
        print(f"port: {port}", flush=True)

    with interruption() as stop, priority():
        if options.udp:
            more = {"loss": options.loss, "key": shared_key()}
            serve_udp(bus, options.udp, announce, stop, rng=rng, **more)
        else:
            serve_terminal(bus, announce, stop)
    return 0


def _maker(options: argparse.Namespace) -> Callable[..., VirtualServo]:
    """What makes a servo of the bus."""
    if options.bus not in _WITH_MODELS:
        return VirtualLx
    usual, servo = _WITH_MODELS[options.bus]
    name = options.servo or usual
    model = model_named(options.bus, name)
    if model is None:
        known = [model.name for model in servo_models(options.bus)]
        raise InputError("--servo", "", repr(name), one_of(name, known))
    return partial(servo, model)


def _laws(options: argparse.Namespace, count: int) -> list[Law]:
    """The law of each servo: the joints of a model in order, or the options for all."""
    if options.model is None:
        for name in ("kp", "kd", "latency", "inertia"):
            value = getattr(options, name)
            if not 0 <= value < np.inf or (name == "inertia" and value == 0):
                raise InputError(f"--{name}", "", f"{value:g}", "a number of at least 0")
        return [Law(options.kp, options.kd, options.latency, options.inertia)] * count
    joints = list(read_model(options.model).joints.values())
    if len(joints) < count:
        raise InputError(options.model, "joints", f"{len(joints)}", f"{count}, as many as --ids")
    return [
        Law(j.kp_Nm_per_rad, j.kd_Nms_per_rad, j.latency_s, j.inertia_kgm2) for j in joints[:count]
    ]
