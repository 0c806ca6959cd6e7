"""``sim2real virtual-servo``."""

from __future__ import annotations

import argparse
import time

import numpy as np

from sim2real.errors import InputError
from sim2real.hardware.interruption import interruption
from sim2real.hardware.lx import BYTE_S, LARGEST_ID
from sim2real.hardware.priority import priority
from sim2real.hardware.virtual_bus import VirtualBus
from sim2real.hardware.virtual_link import serve_terminal, serve_udp
from sim2real.hardware.virtual_servo import VirtualServo
from sim2real.hardware.virtual_shaft import Law
from sim2real.model import read_model


def run(options: argparse.Namespace) -> int:
    """Simulate servos on a bus until Ctrl-C; the first line printed is the port."""
    for name in ("loss", "noise"):
        share = getattr(options, name)
        if not 0 <= share < 1:
            raise InputError(f"--{name}", "", f"{share:g}", "a share from 0 up to 1")
    ids = _ids(options.ids)
    now = time.monotonic()
    servos = [
        VirtualServo(
            servo_id,
            law,
            now,
            supply_V=options.supply,
            temperature_C=options.temperature,
            heating_C_per_s=options.heating,
        )
        for servo_id, law in zip(ids, _laws(options, len(ids)), strict=True)
    ]
    rng = np.random.default_rng(options.seed)
    bus = VirtualBus(
        servos,
        rng,
        noise=options.noise,
        loss=0.0 if options.udp else options.loss,
        echo=options.echo,
        byte_s=0.0 if options.fast else BYTE_S,
    )

    def announce(port: str) -> None:
        print(f"port: {port}", flush=True)

    with interruption() as stop, priority():
        if options.udp:
            serve_udp(bus, _address(options.udp), announce, stop, rng=rng, loss=options.loss)
        else:
            serve_terminal(bus, announce, stop)
    return 0


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


def _ids(text: str) -> list[int]:
    try:
        ids = [int(number) for number in text.split(",")]
    except ValueError:
        ids = []
    if not ids or len(set(ids)) != len(ids) or not all(0 <= k <= LARGEST_ID for k in ids):
        expected = f"different numbers from 0 to {LARGEST_ID}, as 1,2,3"
        raise InputError("--ids", "", repr(text), expected)
    return ids


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise InputError("--udp", "", repr(text), "HOST:PORT, as 127.0.0.1:0")
    return host or "127.0.0.1", int(port)
