"""Controllers by their names on the command line: policy files and classical controllers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rl.controllers import Controller
from rl.controllers.classical import (
    PACES,
    TUNED,
    ADRCGains,
    DisturbanceRejection,
    PNLGains,
    ProportionalNavigation,
    tuned,
)
from rl.controllers.discrete_cpg import read_policy
from rl.deploy.export import read_zip
from rl.deploy.policy import PolicyController, read_npz
from rl.sac.policy_zip import read_settings
from sim2real.errors import InputError
from sim2real.robot import Robot


def with_price(name: str) -> tuple[str, float | None]:
    """The file and the price of energy in a name ``FILE.zip@PRICE``, or the name and no price."""
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


def controller_of(name: str, robot: Robot, *, gains: Path | None = None) -> Controller:
    """The controller of a policy file, ``pnl`` or ``adrc``, with a pace as in ``pnl-fast``.

    For ``FILE.zip@PRICE`` see ``set_price``; ``gains`` is a file of gains, by default the twin's.
    """
    limits = [joint.limits_rad for joint in robot.joints]
    kind, _, pace = name.partition("-")
    if kind in ("pnl", "adrc") and (not pace or pace in PACES):
        file, pace = gains or TUNED, pace or "middle"
        if kind == "pnl":
            return ProportionalNavigation(limits, tuned("pnl", PNLGains, pace, file))
        return DisturbanceRejection(limits, tuned("adrc", ADRCGains, pace, file))
    path, price = with_price(name)
    if name.endswith(".npz"):
        policy = read_npz(name)
    elif price is None and read_settings(path).get("algorithm") == "DQN":
        return read_policy(path, limits)
    else:
        policy = read_zip(path, price=price)
    if len(policy.joints) != len(limits):
        joints = f"{len(policy.joints)} joints"
        raise InputError(name, "joints", joints, f"{len(limits)}, as the robot has")
    return PolicyController(policy)


def named_controllers(policies: Sequence[str], robot: Robot) -> dict[str, Controller]:
    """Controllers of a robot, by the names that are shown."""
    limits = [joint.limits_rad for joint in robot.joints]
    joints = tuple(joint.name for joint in robot.joints)
    out: dict[str, Controller] = {}
    for name in dict.fromkeys(policies):
        controller = controller_of(name, robot)
        if isinstance(controller, PolicyController):
            policy = controller.policy
            if tuple(policy.joints) != joints:
                found = f"a policy of {', '.join(policy.joints)}"
                raise InputError(name, "joints", found, f"{', '.join(joints)} of {robot.name}")
            if not np.allclose(np.array([policy.low, policy.high]).T, limits, atol=1e-3):
                ends = zip(policy.low, policy.high, strict=True)
                found = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in ends)
                raise InputError(name, "limits", f"{found} rad", f"the limits of {robot.name}")
        label = shown(name)
        out[name if label in out else label] = controller
    if not out:
        raise InputError("forecast", "policies", "none", "at least one policy")
    return out
