"""``sim2real scan``."""

from __future__ import annotations

import argparse
import sys

from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.bus import Bus
from sim2real.hardware.lx import BAUD_RATES, CENTRE_TICKS, LARGEST_ID, TICK_RAD
from sim2real.hardware.scan import Found, scan
from sim2real.hardware.transport import open_transport

LOCAL_S, NETWORK_S = 0.01, 0.05  # delay of an adapter or a radio
EXCHANGE_BITS = 14 * 10  # a request and its reply on the wire


def run(options: argparse.Namespace) -> int:
    """Print a table of the servos that answer.

    Returns:
        0 if one did, 1 if none.
    """
    ids = _ids(options.ids)
    network = "://" in options.port
    for baud in BAUD_RATES[: 1 if network else None]:
        patience = (NETWORK_S if network else LOCAL_S) + EXCHANGE_BITS / baud
        with Bus(open_transport(options.port, baud=baud)) as bus:
            try:
                bar = tqdm(ids, desc=f"{baud} baud", unit="id", disable=None)
                servos, garbled = scan(bus, bar, patience)
            except OSError as error:
                reason = error.strerror or error
                print(f"sim2real scan: the port was lost ({reason})", file=sys.stderr)
                return 1
        for servo_id in garbled:
            print(f"id {servo_id}: a corrupted answer, possibly of two servos with this id")
        if servos:
            options.result = servos
            print(_table(servos))
            if baud != BAUD_RATES[0]:
                print(f"They answer at {baud} baud: switch their supply off and on again.")
            return 0
    print(f"sim2real scan: no servo answers on {options.port}", file=sys.stderr)
    return 1


def _table(servos: list[Found]) -> str:
    lines = [f"{'id':>3} {'ticks':>6} {'rad':>7} {'supply':>8} {'temp':>5}  torque  errors"]
    for servo in servos:
        ticks = "-" if servo.ticks is None else f"{servo.ticks}"
        angle = "-" if servo.ticks is None else f"{(servo.ticks - CENTRE_TICKS) * TICK_RAD:+.3f}"
        supply = "-" if servo.supply_V is None else f"{servo.supply_V:.2f} V"
        temperature = "-" if servo.temperature_C is None else f"{servo.temperature_C} C"
        torque = "-" if servo.powered is None else "on" if servo.powered else "off"
        errors = ", ".join(servo.errors) or "none"
        lines.append(
            f"{servo.servo_id:>3} {ticks:>6} {angle:>7} {supply:>8} {temperature:>5}  "
            f"{torque:<6}  {errors}"
        )
    return "\n".join(lines)


def _ids(text: str) -> list[int]:
    """The identities in a list such as ``1,2,10-20``."""
    ids: list[int] = []
    try:
        for part in text.split(","):
            first, _, last = part.partition("-")
            ids += range(int(first), int(last or first) + 1)
    except ValueError:
        ids = []
    if not ids or not all(0 <= k <= LARGEST_ID for k in ids):
        raise InputError("--ids", "", repr(text), f"numbers from 0 to {LARGEST_ID}, as 1,2,10-20")
    return list(dict.fromkeys(ids))
