"""A policy that chooses the gaits of a central pattern generator from a table, and its training.

Similar to the controller "Zhang et al." of the paper (IEEE Trans. Robot., 2022), with another
table, duration of a choice and network; trained by deep Q-learning (Mnih et al., Nature 518, 2015).
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from tqdm import tqdm

from rl.controllers.classical import CentralPatternGenerator, Gait
from rl.make import Fidelity, episodes_of, make_world, own_stream
from rl.observer import PAPER
from rl.sac.checkpoint import write_progress
from rl.sac.policy_zip import PolicyZip, load_weights, read_policy_zip, write_policy_zip
from rl.sac.sac import Spaces
from rl.sac.train import check_run
from rl.task import TASKS
from rl.vec_env import FishVecEnv
from sim2real.arrays import Array, Array32
from sim2real.errors import InputError, check_whole
from sim2real.output import provenance


@dataclass(frozen=True)
class ActionTable:
    """A table of N gaits, see ``Gait``: three columns (N,), and what they have in common."""

    frequency_hz: Array
    amplitude_rad: Array
    offset_rad: Array
    front: float
    lag_rad: float
    hold: int

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def gait(self, choice: NDArray[np.integer]) -> Gait:
        """The gaits of choices (E,)."""
        columns = (self.frequency_hz, self.amplitude_rad, self.offset_rad)
        frequency, amplitude, offset = (column[choice] for column in columns)
        return Gait(frequency, amplitude, self.front, self.lag_rad, offset)

    def content(self) -> dict[str, Any]:
        """The table as JSON values."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}


_MOVING = [(f, 0.6, bend) for f in (0.8, 1.6, 2.4) for bend in (-0.6, -0.3, 0.0, 0.3, 0.6)]
_frequency, _amplitude, _offset = np.array([*_MOVING, (0.8, 0.0, 0.0)]).T
TABLE = ActionTable(_frequency, _amplitude, _offset, front=1.2, lag_rad=0.8, hold=10)
"""Sixteen gaits, the last at rest, each used for 0.2 s: half a beat of the fastest."""


class DiscreteCPG:
    """A trained policy as a controller; ``table`` must be that of the training."""

    def __init__(self, model: DQN, limits_rad: ArrayLike, table: ActionTable = TABLE) -> None:
        self.model, self.table, self._limits = model, table, limits_rad
        self.reset()

    def reset(self) -> None:
        """All robots begin anew."""
        self._period = 0

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        if self._period == 0:
            self._generator = CentralPatternGenerator(self._limits, len(observation))
            self._generator.reset(observation)
        if self._period % self.table.hold == 0:
            inputs = with_phase(observation, self._generator)
            self._gait = self.table.gait(self.model.predict(inputs, deterministic=True)[0])
        self._period += 1
        return self._generator.step(self._gait).astype(np.float32)


def with_phase(
    observation: NDArray[np.floating],
    generator: CentralPatternGenerator,
    rows: slice | list[int] = slice(None),
) -> Array32:
    """The observations (E, N) with two columns for the phase of the generator's ``rows``."""
    phase = generator.phase[rows, 0]
    columns = [observation, np.sin(phase)[:, None], np.cos(phase)[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)


class DiscreteCPGEnv(VecEnvWrapper):
    """A vector environment whose actions are rows of ``TABLE``, each used for its ``hold`` periods.

    Rewards are summed over the periods, until an episode ends. Observations include sine and cosine
    of the first joint's phase. Actions -1 and 1 of ``venv`` are joint limits.
    """

    def __init__(self, venv: VecEnv) -> None:
        space: Any = venv.observation_space
        low, high = np.append(space.low, [-1, -1]), np.append(space.high, [1, 1])
        box = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        super().__init__(venv, box, spaces.Discrete(len(TABLE)))
        limits = np.stack([np.asarray(venv.get_attr(name)[0]) for name in ("low", "high")], axis=1)
        self._generator = CentralPatternGenerator(limits, venv.num_envs)
        self._choice = np.zeros(venv.num_envs, dtype=np.int64)

    def reset(self) -> Array32:  # type: ignore[override]
        """As ``VecEnv.reset``."""
        observation: Any = self.venv.reset()
        self._generator.reset(observation)
        return with_phase(observation, self._generator)

    def step_async(self, actions: NDArray[np.integer]) -> None:  # type: ignore[override]
        """Store the choices (E,)."""
        self._choice = np.asarray(actions, dtype=np.int64)

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate the choices for ``TABLE.hold`` periods."""
        gait, (low, high) = TABLE.gait(self._choice), self._generator.limits_rad.T
        observation: Any = None
        reward = np.zeros(self.num_envs, dtype=np.float32)
        ended = np.zeros(self.num_envs, dtype=bool)
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(TABLE.hold):
            angle = self._generator.step(gait)
            self.venv.step_async((2 * (angle - low) / (high - low) - 1).astype(np.float32))
            observation, rewards, done, infos = self.venv.step_wait()
            reward += np.where(ended, 0.0, rewards).astype(np.float32)
            for e in np.flatnonzero(done & ~ended).tolist():
                last = np.atleast_2d(infos[e]["terminal_observation"])
                (seen,) = with_phase(last, self._generator, [e])
                told[e] = {**infos[e], "terminal_observation": seen}
            ended |= done
            if done.any():
                self._generator.reset(observation, mask=done)
        return with_phase(observation, self._generator), reward, ended, told


class GaitDQN(DQN):
    """Deep Q-learning whose choices are rows of a table, saved without pickled objects."""

    gaits: Mapping[str, Any]
    joints: list[str]

    def save(self, path: Any, *_: Any, **__: Any) -> None:  # noqa: ANN401 - as the base class
        """Write ``policy.zip``, without pickled objects."""
        settings = {"algorithm": "DQN", "gaits": self.gaits, "joints": self.joints}
        write_policy_zip(path, self.policy, settings, {})


def read_policy(path: str | os.PathLike[str], limits_rad: ArrayLike) -> DiscreteCPG:
    """Read a policy of ``train_run`` for joints with ``limits_rad`` (J, 2)."""
    saved = read_policy_zip(path, "DQN")
    table = _table(saved)
    columns, *hidden, choices = saved.widths("q_net.q_net")
    joints = len(np.asarray(limits_rad))
    if columns != 7 + 2 * joints:
        expected = f"{7 + 2 * joints} for the robot's {joints} joints"
        raise InputError(Path(path), "observation", f"{columns} columns", expected)
    if choices != len(table):
        raise InputError(Path(path), "gaits", f"{len(table)}", f"{choices}, as the network has")
    box = spaces.Box(-np.inf, np.inf, (columns,), dtype=np.float32)
    env, network = Spaces(box, spaces.Discrete(choices)), {"net_arch": hidden}
    model = GaitDQN("MlpPolicy", env, buffer_size=1, policy_kwargs=network, device="cpu")
    load_weights(path, model.policy, saved.weights)
    return DiscreteCPG(model, limits_rad, table)


def _table(saved: PolicyZip) -> ActionTable:
    """The gaits of a trained policy."""
    table = saved.settings.table("gaits")
    frequency = table.numbers("frequency_hz", "numbers")
    size = len(frequency)
    amplitude, offset = (
        table.numbers(name, f"{size} numbers, as there are frequencies", size)
        for name in ("amplitude_rad", "offset_rad")
    )
    hold = table.number("hold", low=1)
    if hold > 1000:
        raise table.error("hold", "at most 1000")
    scalars = table.number("front"), table.number("lag_rad"), int(hold)
    return ActionTable(np.array(frequency), np.array(amplitude), np.array(offset), *scalars)


COLUMNS = ("steps", "episodes", "mean_return", "success", "mean_length", "exploration")
QUICK: dict[str, Any] = {"task": "near", "steps": 1_000_000, "envs": 32, "energy_weight": 1e-4}
"""Settings of ``train --quick``: a minute or two on one core, in the twin."""
ACCEPTED = ("task", "steps", "envs", "energy_weight")
"""Options of the command ``train`` that ``train_run`` accepts."""
SETTINGS: dict[str, Any] = {
    "gamma": 0.95,  # per choice: 0.95 per 0.2 s is a horizon of 4 s
    "rate": 1e-3,
    "memory": 100_000,  # choices
    "batch": 256,
    "hidden": [64, 64],
    "warm_up": 2_000,  # random choices before learning begins
    "updates": 8,  # per choice of all robots
    "follow": 200,  # choices between copies to the target network
    "exploring": 0.3,  # share of the training over which exploration decreases to the least
    "least": 0.05,  # final share of random choices
}
"""Hyper-parameters."""


def make_dqn(env: VecEnv, seed: int) -> GaitDQN:
    """An untrained agent for ``env``, a ``DiscreteCPGEnv``."""
    s = SETTINGS
    return GaitDQN(
        "MlpPolicy", env, learning_rate=s["rate"], buffer_size=s["memory"],
        learning_starts=s["warm_up"], batch_size=s["batch"], gamma=s["gamma"], train_freq=1,
        gradient_steps=s["updates"], target_update_interval=s["follow"],
        exploration_fraction=s["exploring"], exploration_final_eps=s["least"],
        policy_kwargs={"net_arch": s["hidden"]}, seed=seed, device="cpu",
    )  # fmt: skip


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    task: str = "point",
    steps: int = 1_000_000,
    envs: int = 32,
    seeds: Sequence[int] = (0,),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    energy_weight: float | None = None,
) -> list[Path]:
    """Train an agent for each seed in turn, unless finished before; the folders of the agents."""
    for option, value in (("--steps", steps), ("--envs", envs)):
        check_whole("train", option, value, 1)
    fish, draws, inputs = episodes_of(robot, model, ranges)
    chosen, gaits = TASKS[task], TABLE.content()
    if energy_weight is not None:
        chosen = replace(chosen, energy=energy_weight)
    description = {
        "controller": "discrete-cpg", "task": task, "energy": chosen.energy, "steps": steps,
        "envs": envs, "fidelity": fidelity, "gaits": gaits, "settings": SETTINGS,
    }  # fmt: skip
    folders = [folder / f"policy-{seed}" for seed in seeds]
    for directory, seed in zip(folders, seeds, strict=True):
        note = provenance(inputs, seed)
        check_run(directory, {**description, "seed": seed}, note, same=("inputs",))
        if (directory / "policy.zip").exists():
            continue
        with own_stream(device):
            world = make_world(
                fish, chosen, draws, n_envs=envs, seed=seed, fidelity=fidelity, device=device,
                cell_m=cell_m, threads=threads,
            )  # fmt: skip
            agent = make_dqn(DiscreteCPGEnv(FishVecEnv(world, PAPER)), seed)
            rows = _learn(agent, steps)
        agent.gaits, agent.joints = gaits, [joint.name for joint in fish.joints]
        write_progress(directory / "progress.csv", COLUMNS, rows)
        agent.save(directory / "policy.zip")
    return folders


def _learn(agent: GaitDQN, steps: int) -> list[list[float]]:
    """Train for ``steps`` of all robots together; rows of ``progress.csv``."""
    rows: list[list[float]] = []
    ended: list[tuple[float, float, float]] = []
    bar = tqdm(total=steps, desc="train", unit="step", disable=None)

    def note() -> None:
        mean = np.mean(ended, axis=0) if ended else np.full(3, np.nan)
        rows.append([agent.num_timesteps * TABLE.hold, len(ended), *mean, agent.exploration_rate])
        if ended:
            bar.set_postfix_str(f"{100 * mean[1]:.0f} % arrive")
        ended.clear()

    def after_step(scope: dict[str, Any], _: dict[str, Any]) -> bool:
        over = [info for info in scope["infos"] if "episode" in info]
        ended.extend((x["episode"]["r"], x["is_success"], x["episode"]["l"]) for x in over)
        done = agent.num_timesteps * TABLE.hold
        bar.update(done - bar.n)
        if done >= (len(rows) + 1) * max(1, steps // 50):
            note()
        return True

    with bar:
        agent.learn(-(-steps // TABLE.hold), callback=after_step)
        if ended or not rows:
            note()
    return rows
