"""``sim2real virtual-servo``."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from sim2real.errors import InputError, one_of
from sim2real.hardware.buses import bus_class
from sim2real.hardware.mounting import check_ids
from sim2real.hardware.process import interruption, priority
from sim2real.hardware.servo_models import model_named, servo_models
from sim2real.hardware.shared_key import shared_key
from sim2real.hardware.virtual_bus import Law, VirtualBus, VirtualServo
from sim2real.hardware.virtual_link import serve_terminal, serve_udp
from sim2real.hardware.virtual_servos import VirtualDynamixel, VirtualFeetech, VirtualLx
from sim2real.model import read_model

_USUAL = {"dynamixel": "XL330-M288", "feetech": "STS3215"}


def run(options: argparse.Namespace) -> int:
    """Simulate servos on a bus until Ctrl-C; the first line printed is the port."""
    kind = bus_class(options.bus)
    for name in ("loss", "noise"):
        share = getattr(options, name)
        if not 0 <= share < 1:
            raise InputError(f"--{name}", "", f"{share:g}", "a share from 0 up to 1")
    ids = _ids(options.ids, kind.protocol.largest_id)
    baud = kind.baud_rates[0] if options.baud is None else options.baud
    if baud <= 0:
        raise InputError("--baud", "", f"{baud}", "a rate above 0, such as 1000000")
    make = _maker(options)
    now = time.monotonic()
    health = {
        "supply_V": options.supply,
        "temperature_C": options.temperature,
        "heating_C_per_s": options.heating,
    }
    laws = zip(ids, _laws(options, len(ids)), strict=True)
    servos = [make(servo_id, law, now, **health) for servo_id, law in laws]
    rng = np.random.default_rng(options.seed)
    bus = VirtualBus(
        servos,
        kind.protocol,
        rng,
        noise=options.noise,
        loss=0.0 if options.udp else options.loss,
        echo=options.echo,
        baud=baud,
        fast=options.fast,
    )

    def announce(port: str) -> None:
        print(f"port: {port}", flush=True)

    with interruption() as stop, priority():
        if options.udp:
            key, where = shared_key(), _address(options.udp)
            serve_udp(bus, where, announce, stop, rng=rng, loss=options.loss, key=key)
        else:
            serve_terminal(bus, announce, stop)
    return 0


def _maker(options: argparse.Namespace) -> Callable[..., VirtualServo]:
    """What makes a servo of the bus."""
    if options.bus == "lx":
        return VirtualLx
    name = options.servo or _USUAL[options.bus]
    model = model_named(options.bus, name)
    if model is None:
        known = [model.name for model in servo_models(options.bus)]
        raise InputError("--servo", "", repr(name), one_of(name, known))
    kind = VirtualDynamixel if options.bus == "dynamixel" else VirtualFeetech
    return partial(kind, model)


def _laws(options: argparse.Namespace, count: int) -> list[Law]:
    """The law of each servo: the joints of a model in order, or the options for all."""
    if options.model is None:
        law = Law(options.kp, options.kd, options.latency, options.inertia)
        for name in ("kp", "kd", "latency", "inertia"):
            value = getattr(options, name)
            if not 0 <= value < np.inf or (name == "inertia" and value == 0):
                raise InputError(f"--{name}", "", f"{value:g}", "a number of at least 0")
        return [law] * count
    joints = list(read_model(options.model).joints.values())
    if len(joints) < count:
        raise InputError(options.model, "joints", f"{len(joints)}", f"{count}, as many as --ids")
    return [
        Law(j.kp_Nm_per_rad, j.kd_Nms_per_rad, j.latency_s, j.inertia_kgm2) for j in joints[:count]
    ]


def _ids(text: str, largest: int) -> list[int]:
    try:
        ids = [int(number) for number in text.split(",")]
    except ValueError:
        raise InputError("--ids", "", repr(text), "whole numbers, as 1,2,3") from None
    check_ids(ids, largest)
    return ids


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise InputError("--udp", "", repr(text), "HOST:PORT, as 127.0.0.1:0")
    return host or "127.0.0.1", int(port)
