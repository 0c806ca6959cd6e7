"""``sim2real scan``."""

from __future__ import annotations

import argparse
import sys

from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.bench import scan, table
from sim2real.hardware.buses import bus_class, connection

LOCAL_S, NETWORK_S = 0.01, 0.05  # delay of an adapter or a radio
EXCHANGE_BITS = 32 * 10  # a request and its reply on the wire


def run(options: argparse.Namespace) -> int:
    """Print a table of the servos that answer.

    Returns:
        0 if one did, 1 if none.
    """
    kind = bus_class(options.bus)
    ids = _ids(options.ids, kind.protocol.largest_id)
    network = "://" in options.port
    rates = kind.baud_rates[: 1 if network else None] if options.baud is None else (options.baud,)
    for baud in rates:
        patience = (NETWORK_S if network else LOCAL_S) + EXCHANGE_BITS / baud
        with connection(options.bus, options.port, baud) as link:
            try:
                bar = tqdm(ids, desc=f"{baud} baud", unit="id", disable=None)
                servos, garbled = scan(link.bus, bar, patience)
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
                print(f"They answer at {baud} baud{_ADVICE[options.bus]}.")
            return 0
    tried = ", ".join(str(baud) for baud in rates)
    print(
        f"sim2real scan: no servo answers on {options.port} ({options.bus}, {tried} baud): "
        "check supply, --bus, --baud and --ids",
        file=sys.stderr,
    )
    return 1


_ADVICE = {
    "lx": ": switch their supply off and on again",
    "dynamixel": ": pass it as --baud to other commands",
    "feetech": ": pass it as --baud to other commands",
}


def _ids(text: str, largest: int) -> list[int]:
    """The identities in a list such as ``1,2,10-20``."""
    ids: list[int] = []
    try:
        for part in text.split(","):
            first, _, last = part.partition("-")
            ids += range(int(first), int(last or first) + 1)
    except ValueError:
        ids = []
    if not ids or not all(0 <= k <= largest for k in ids):
        raise InputError("--ids", "", repr(text), f"numbers from 0 to {largest}, as 1,2,10-20")
    return list(dict.fromkeys(ids))
