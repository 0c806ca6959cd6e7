"""Controllers by their names on the command line: policy files and classical controllers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rl.controllers import Controller
from rl.controllers.classical import PACES, TUNED, tuned
from rl.deploy.export import read_zip
from rl.deploy.policy import PolicyController, read_npz
from sim2real.errors import InputError

CONTROLLERS = ("pnl", "adrc")
"""Classical controllers, by their names on the command line."""


def with_price(name: str) -> tuple[str, float | None]:
    """The file and the price of energy in a name ``FILE.zip@PRICE``, or the name and no price.

    Raises:
        InputError: If the price is no number.
    """
    file, _, price = name.rpartition("@")
    if not file.endswith(".zip"):
        return name, None
    try:
        return file, float(price)
    except ValueError:
        raise InputError(file, "price", repr(price), "a number, as in policy.zip@0.5") from None


def shown(name: str) -> str:
    """Display name of a policy: that of its file, or of its folder if the file is ``policy``."""
    file, price = with_price(name)
    path, suffix = Path(file), "" if price is None else f" at {price:g}"
    return (path.parent.name if path.stem == "policy" and path.parent.name else path.stem) + suffix


def controller_of(
    name: str, limits_rad: Sequence[tuple[float, float]], n_envs: int, *, gains: Path | None = None
) -> Controller:
    """The controller of a policy file or one of ``CONTROLLERS``, with a pace as in ``pnl-fast``.

    For ``FILE.zip@PRICE`` see ``set_price``; ``gains`` is a file of tuned gains, by default of
    those tuned in the twin.

    Raises:
        InputError: If it is neither, or was not trained for the price.
    """
    kind, _, pace = name.partition("-")
    if kind in CONTROLLERS and (not pace or pace in PACES):
        from rl.controllers.classical import (
            ADRCGains,
            DisturbanceRejection,
            PNLGains,
            ProportionalNavigation,
        )

        file, pace = gains or TUNED, pace or "middle"
        if kind == "pnl":
            pnl_gains = tuned("pnl", PNLGains, pace, file)
            return ProportionalNavigation(limits_rad, n_envs, pnl_gains)
        return DisturbanceRejection(limits_rad, n_envs, tuned("adrc", ADRCGains, pace, file))
    from rl.controllers.discrete_cpg import read_policy, read_table

    if (table := read_table(name)) is not None:
        return read_policy(name, table, limits_rad, n_envs)
    path, price = with_price(name)
    policy = read_npz(name) if name.endswith(".npz") else read_zip(path, price=price)
    if len(policy.joints) != len(limits_rad):
        joints = f"{len(policy.joints)} joints"
        raise InputError(name, "joints", joints, f"{len(limits_rad)}, as the robot has")
    return PolicyController(policy)
