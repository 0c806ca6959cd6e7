"""Controllers by the names that a command line takes: files of policies, and those not learned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rl.controllers import Controller
from rl.controllers.tuned import PACES, TUNED, tuned
from rl.deploy.controller import PolicyController
from rl.deploy.export import read_zip
from rl.deploy.forward import read_npz
from rl.sac.sampled import SampledController
from sim2real.errors import InputError

CONTROLLERS = ("pnl", "adrc")
"""Those that are not learned, by the names a command line takes in a policy's place."""


def with_price(name: str) -> tuple[str, float | None]:
    """The file and the price of energy of a policy that is called ``FILE.zip@PRICE``.

    Args:
        name: Of a controller; with no price in it, it is the file's.

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


def controller_of(
    name: str,
    limits_rad: Sequence[tuple[float, float]],
    n_envs: int,
    *,
    gains: Path | None = None,
    sampled: bool = False,
) -> Controller:
    """A policy's file, or one of ``CONTROLLERS``, at a pace as in ``pnl-fast``.

    Args:
        name: Which; ``FILE.zip@PRICE`` swims at another price of energy, see ``set_price``.
        limits_rad: Of the robot's joints, lowest and highest.
        n_envs: Number of robots.
        gains: File of the tuned gains; that of the twin where None.
        sampled: Whether a policy's ``.zip`` acts as in training, with noise.

    Raises:
        InputError: If it is neither, or did not learn for the price.
    """
    kind, _, pace = name.partition("-")
    if kind in CONTROLLERS and (not pace or pace in PACES):
        from rl.controllers.adrc import ADRCGains, DisturbanceRejection
        from rl.controllers.pnl import PNLGains, ProportionalNavigation

        file, pace = gains or TUNED, pace or "middle"
        if kind == "pnl":
            known = tuned("pnl", PNLGains, pace, file)
            return ProportionalNavigation(limits_rad, n_envs, known)
        return DisturbanceRejection(limits_rad, n_envs, tuned("adrc", ADRCGains, pace, file))
    from rl.controllers.discrete_cpg import read_policy, read_table

    if (table := read_table(name)) is not None:
        return read_policy(name, table, limits_rad, n_envs)
    path, price = with_price(name)
    policy = read_npz(name) if name.endswith(".npz") else read_zip(path, price=price)
    if len(policy.joints) != len(limits_rad):
        found = f"{len(policy.joints)} joints"
        raise InputError(name, "joints", found, f"{len(limits_rad)}, as the robot has")
    if sampled and not name.endswith(".npz"):
        return SampledController(path, price=price)
    return PolicyController(policy)
