"""Policies swim in drawn realities, in a simulator with the errors that it is known to have."""

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.signal import lfilter
from torch.utils.dlpack import from_dlpack

from rl.controllers import Controller
from rl.experiments.episodes import FIGURES, Episodes, measured
from rl.experiments.testbeds import SimulationSettings, simulate
from rl.forecast.realities import Realities
from rl.make import digest
from rl.task import CONTROL_S, Task
from rl.world import Draws
from sim.robot.live import Live, Simulator
from sim2real.arrays import Array, Array32, Index, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.output import write_whole
from sim2real.progress import Progress
from sim2real.robot import Robot
from sim2real.structured import read_arrays


@dataclass(frozen=True)
class Forecaster:
    """``trials`` of policies in each drawn reality; starts, noise and disturbances are common."""

    robot: Robot
    task: Task
    realities: Realities
    trials: int
    seed: int
    settings: SimulationSettings
    residuals: Sequence[Array] = ()
    at_once: int = 50  # realities in a batch

    def swim(
        self,
        controllers: Mapping[str, Controller],
        *,
        file: Path | None = None,
        key: str = "",
        progress: Progress = lambda share: None,
    ) -> dict[str, Array]:
        """Run all K policies in all N realities; trials in ``file`` with the same ``key`` are kept.

        The result: each of ``FIGURES``, (K, N, T); of the first trial in the first twenty realities
        ``paths``, positions every 0.1 s in m, NaN after the end, shape (K, n, S, 2), and
        ``targets``, waypoints in m, shape (n, W, 2).
        """
        N, K, T = len(self.realities.models), len(controllers), self.trials
        n, samples = min(20, N), -(-(self.task.steps + 1) // 5)
        own = digest((key, list(controllers), N, T, self.seed, self.at_once))
        table = {
            **{name: np.full((K, N, T), np.nan) for name in FIGURES},
            "paths": np.full((K, n, samples, 2), np.nan),
            "targets": np.full((n, self.task.waypoints, 2), np.nan),
        }
        if file is not None and file.exists():
            with contextlib.suppress(InputError):  # a damaged file is written anew
                kept = read_arrays(file, "trials of a forecast")
                if str(kept.pop("digest", None)) == own:
                    table = kept
        batches = np.array_split(np.arange(N), range(self.at_once, N, self.at_once))
        for part, rows in enumerate(batches):
            head, law = rows[rows < n], np.repeat(self.realities.law[rows, 3], T)
            for k, controller in enumerate(controllers.values()):
                if np.isnan(table["success"][k, rows]).any():
                    episodes = self._episodes(part, rows, controller)
                    figures = measured(episodes, self.task)
                    more = law * figures["energy"]  # the error of the energy of each reality
                    figures["energy"] = figures["energy"] + more
                    figures["reward"] = figures["reward"] - self.task.energy * more
                    for name, values in figures.items():
                        table[name][k, rows] = values.reshape(-1, T)
                    path = episodes.pose[::5, : len(head) * T : T, :2]
                    table["paths"][k, head, : len(path)] = np.moveaxis(path, 1, 0)
                    table["targets"][head] = episodes.targets[: len(head) * T : T]
                    if file is not None:
                        stream = io.BytesIO()
                        content: dict[str, Any] = {"digest": np.array(own), **table}
                        np.savez_compressed(stream, **content)
                        write_whole(file, stream.getvalue())
                progress((part * K + k + 1) / (K * len(batches)))
        return table

    def _episodes(self, part: int, rows: Index, who: Controller) -> Episodes:
        """Trials of one policy in the realities of a batch, numbers ``rows``."""
        each = np.repeat(rows, self.trials)
        rng, E, steps = np.random.default_rng([self.seed, part]), len(each), self.task.steps
        starts = self.task.place(rng, E, len(self.robot.joints))
        if self.residuals:
            disturbance = blocks(self.residuals, steps, E, rng)
        else:
            disturbance = disturbances(self.realities.unexplained, steps, E, rng)
        draws = [Draws((self.realities.models[d],), self.realities.noise) for d in each]
        around = partial(Inexact, law=self.realities.law[each, :3], disturbance=disturbance)
        return simulate(
            who, self.robot, self.task, starts, int(rng.integers(2**31)), draws=draws,
            settings=self.settings, name="forecast", around=around,
        )  # fmt: skip


class Inexact:
    """Robots of a simulator whose motion differs from the simulated one as measured motion does.

    Velocities of the body have a relative error and a disturbance, joints a disturbance of their
    set-points; the path is integrated anew from the changed velocities.
    """

    def __init__(self, simulator: Simulator, law: Array, disturbance: Array32) -> None:
        """Wrap a simulator of E robots that are all reset at the same time.

        ``law`` are relative errors of surge, sway and yaw rate (E, 3); ``disturbance`` is of these
        in m/s and rad/s and of set-points in rad, (T, E, 3 + J), repeated after T periods.
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
    def current(self) -> Array:
        """Velocity of the pool's water, shape (E, 2)."""
        return self.simulated.current

    def live(self) -> Live:
        """The live state, with the changed path."""
        shown: Any = self._shown
        return replace(self._live, q=shown)

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


def disturbances(sd: Array, periods: int, n: int, rng: np.random.Generator) -> Array32:
    """First-order autoregressive signals over 0.3 s, with ``sd`` (K,), shape (periods, n, K)."""
    keep = float(np.exp(-CONTROL_S / 0.3))
    white = rng.standard_normal((periods, n, sd.size)).astype(np.float32)
    white[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0) * sd, dtype=np.float32)


def blocks(residuals: Sequence[Array], periods: int, n: int, rng: np.random.Generator) -> Array32:
    """Blocks of two seconds of recorded residuals (T, K) in a row, shape (periods, n, K).

    A block bootstrap (Kunsch, Ann. Stat. 17 (1989) 1217) of all signals together.
    """
    length = min(100, *(len(one) for one in residuals))
    starts = [(r, t) for r, one in enumerate(residuals) for t in range(len(one) - length + 1)]
    chosen = rng.integers(len(starts), size=(-(-periods // length), n))
    rows = (
        np.stack([residuals[r][t : t + length] for r, t in (starts[pick] for pick in row)], axis=1)
        for row in chosen
    )
    return np.concatenate([row.astype(np.float32) for row in rows])[:periods]
