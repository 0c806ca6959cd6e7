"""An independent check of the limits of commands."""

import numpy as np


def violations(commands, limits, slack=1e-9):
    """How each of some commands breaks the limits, one sentence each; empty where it keeps them."""
    low, high = limits.position_rad
    rate = np.abs(np.diff(commands, axis=1)).max(axis=1) / limits.period_s
    step = commands / limits.resolution_rad
    off = np.abs(step - np.round(step)).max(axis=1) * limits.resolution_rad
    still = round(limits.rest_s / limits.period_s)
    ends = np.concatenate([commands[:, :still], commands[:, -still:]], axis=1)
    away = np.abs(ends - limits.rest_rad).max(axis=1)
    found = []
    for n, command in enumerate(commands):
        broken = []
        if command.min() < low - slack or command.max() > high + slack:
            broken.append(f"{command.min():.4g} to {command.max():.4g} rad leave the range")
        if rate[n] > limits.rate_rad_s + slack / limits.period_s:
            broken.append(f"{rate[n]:.4g} rad/s exceed {limits.rate_rad_s:.4g} rad/s")
        if off[n] > slack + 1e-6 * limits.resolution_rad:
            broken.append(f"not in steps of {limits.resolution_rad:.4g} rad")
        if away[n] > slack:
            broken.append(f"not at rest at {limits.rest_rad:.4g} rad at the beginning and the end")
        found.append(broken)
    return found
