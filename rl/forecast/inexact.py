"""A simulator with the errors that it is known to have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch
from scipy.signal import lfilter
from torch.utils.dlpack import from_dlpack

from rl.task import CONTROL_S
from sim.robot.effects import Outside
from sim.robot.live import Live, Simulator
from sim.robot.shape import Hull
from sim.view.plane import front_ends
from sim2real.arrays import Array, Array32, Index, Mask
from sim2real.model import Model


class Inexact:
    """Robots of a simulator whose motion differs from the simulated one as measured motion does.

    Velocities of the body in its own frame have a relative error and a disturbance, joints a
    disturbance of their set-points. The simulator's state is not changed: the pool is alike
    everywhere, so that the path is integrated anew from the changed velocities.
    """

    def __init__(self, simulator: Simulator, law: Array, disturbance: Array32) -> None:
        """Wrap a simulator of E robots that are all reset at the same time.

        Args:
            simulator: The simulator.
            law: Relative errors of surge, sway and yaw rate, shape (E, 3).
            disturbance: Of surge and sway in m/s, yaw rate in rad/s and set-points in rad, shape
                (T, E, 3 + J); repeated after T periods.
        """
        self.simulated, self._live = simulator, simulator.live()
        self.robot, self.n_envs = simulator.robot, simulator.n_envs
        self._q, self._command = from_dlpack(self._live.q), from_dlpack(self._live.command)
        device = self._q.device
        self._factor = 1.0 + torch.as_tensor(law, dtype=torch.float64, device=device)
        self._disturbance = torch.as_tensor(disturbance, dtype=torch.float32, device=device)
        self._shown = self._q.clone()
        self._period = 0

    @property
    def outside(self) -> Outside:
        """Effects on the robots."""
        return self.simulated.outside

    def live(self) -> Live:
        """The live state, with the changed path."""
        shown: Any = self._shown
        return replace(self._live, q=shown)

    @property
    def hull(self) -> Hull:
        """Shape of the links."""
        simulated: Any = self.simulated
        return cast(Hull, simulated.hull)

    def links(self, robot: int) -> Array:
        """Front end and heading of each link of one robot on the changed path, shape (L, 3)."""
        bodies: Any = getattr(self.simulated, "bodies", self.simulated)
        links = front_ends(bodies.chain, bodies.motion, np.zeros(2), robot)
        head, shown = (q[robot, :3].cpu().numpy() for q in (self._q, self._shown))
        turn = shown[2] - head[2]
        c, s = np.cos(turn), np.sin(turn)
        links[:, :2] = (links[:, :2] - head[:2]) @ np.array([[c, s], [-s, c]]) + shown[:2]
        links[:, 2] += turn
        return links

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """As the simulator's."""
        self.simulated.adopt(which, models)

    def reset(
        self, mask: Mask | None = None, pose: Array | None = None, joint: Array | None = None
    ) -> None:
        """As the simulator's."""
        self.simulated.reset(mask, pose, joint)
        self._shown.copy_(self._q)
        self._period = 0

    def advance(self) -> None:
        """Advance by one control period."""
        disturbance = self._disturbance[self._period % len(self._disturbance)].double()
        self._period += 1
        before = self._q[:, :3].clone()
        self._command += disturbance[:, 3:]
        self.simulated.advance()
        step = self._q[:, :3] - before
        step[:, :2] = _turned(step[:, :2], -(before[:, 2] + step[:, 2] / 2))
        step = step * self._factor + CONTROL_S * disturbance[:, :3]
        step[:, :2] = _turned(step[:, :2], self._shown[:, 2] + step[:, 2] / 2)
        self._shown[:, :3] += step
        self._shown[:, 3:] = self._q[:, 3:]


def _turned(vectors: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    """Vectors (E, 2) turned by angles (E,)."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y = vectors.unbind(1)
    return torch.stack([c * x - s * y, s * x + c * y], dim=1)


def disturbances(
    sd: Array, periods: int, n: int, rng: np.random.Generator, *, correlation_s: float = 0.3
) -> Array32:
    """Stationary random signals, first-order autoregressive, shape (periods, n, K).

    Of standard deviations ``sd`` (K,). Their autocorrelation lasts for a third of a tail beat, as
    residuals of simulated swims change with the beat.
    """
    keep = float(np.exp(-CONTROL_S / correlation_s))
    white = rng.standard_normal((periods, n, sd.size)).astype(np.float32)
    white[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0) * sd, dtype=np.float32)


def blocks(
    residuals: Sequence[Array], periods: int, n: int, rng: np.random.Generator, *, length: int = 100
) -> Array32:
    """Signals made of blocks of recorded residuals, shape (periods, n, K) (a block bootstrap).

    Kunsch, Ann. Stat. 17 (1989) 1217. Signals of a block stay together, so that their correlation
    is kept, too. Residuals of each recording, shape (T, K), are at every control period; a block is
    ``length`` periods, two seconds.
    """
    length = min(length, *(len(one) for one in residuals))
    starts = [(r, t) for r, one in enumerate(residuals) for t in range(len(one) - length + 1)]
    chosen = rng.integers(len(starts), size=(-(-periods // length), n))
    out = np.empty((len(chosen) * length, n, residuals[0].shape[1]), dtype=np.float32)
    for b, row in enumerate(chosen):
        for e, pick in enumerate(row):
            r, t = starts[pick]
            out[b * length : (b + 1) * length, e] = residuals[r][t : t + length]
    return out[:periods]
