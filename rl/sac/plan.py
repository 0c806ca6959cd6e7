"""Plans of a training: hyper-parameters, recipes of this library and of the paper, options."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

from rl.make import Fidelity
from rl.observer import PAPER, View
from rl.task import TASKS, Task
from rl.world import Draws
from sim2real.errors import InputError, check_choice


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters; the defaults are those of this library, ``PLAIN`` those of the paper."""

    gamma: float = 0.99  # discount factor per decision
    memory: int = 1_000_000  # size of the replay memory of each agent, in transitions
    batch: int = 256  # transitions of an update
    rate: float = 1e-3  # initial learning rate
    rate_end: float = 0.1  # final learning rate as a share of ``rate``; it decays linearly
    tau: float = 0.005  # interpolation factor of the target networks per update
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers
    warm_up: int = 10_000  # steps of random actions before learning begins
    updates_per_step: float = 0.1  # updates for each step of an environment
    entropy_start: float = 0.1  # initial entropy coefficient, of the order of a decision's reward
    # target entropy per joint, at the start and at the end of training; a low final value makes
    # the mean action, which is used after training, representative
    entropy_target: tuple[float, float] = (-1.0, -2.5)
    # correlation time of the exploration noise, 0 for white noise, which at 20 ms only makes a
    # joint shake (Eberhard et al., "Pink noise is all you need", ICLR 2023)
    noise_s: float = 0.25
    mirror: bool = True  # replace transitions by their mirror images with probability 1/2
    # layer normalization in the critics: fewer seeds fail (Lyle et al., "Understanding plasticity
    # in neural networks", ICML 2023, among others)
    norm: bool = True
    # agents observe a price of energy and learn for all between 1 / ``prices`` and ``prices`` times
    # their default (Abels et al., "Dynamic weights in multi-objective deep reinforcement learning",
    # ICML 2019); 1 for the default only
    prices: float = 2.0
    # the saved actor is an average, with most weight on this last share of the updates
    # (polynomial-decay averaging; Shamir and Zhang, "Stochastic gradient descent for non-smooth
    # optimization", ICML 2013); 0 for the last actor
    average: float = 0.2


PLAIN = Settings(
    rate=3e-4, rate_end=1.0, hidden=(256, 256), warm_up=100, updates_per_step=1.0,
    entropy_start=1.0, entropy_target=(-1.0, -1.0), noise_s=0.0, mirror=False, norm=False,
    prices=1.0, average=0.0,
)  # fmt: skip
"""SAC of the paper (Lin, Liu, Wang, Table I). What it leaves unsaid, the first 100 random steps and
the initial entropy coefficient of 1, is as in Stable-Baselines3."""


class Arm(NamedTuple):
    """A group of agents: its name, also of its folder, and the robots and noise of its episodes."""

    name: str
    draws: Draws


@dataclass(frozen=True)
class Plan:
    """Plan of a training."""

    task: Task
    steps: int = 1_600_000  # control periods of each agent
    envs: int = 64  # environments of each agent
    segment: int = 200_000  # control periods between checkpoints
    seeds: tuple[int, ...] = (0,)  # random seeds, one agent for each
    fidelity: Fidelity = "fluid"
    device: str = "cpu"
    cell_m: float = 0.02
    threads: int = 1
    settings: Settings = field(default_factory=Settings)
    view: View = field(default_factory=View)
    # initial weight of energy as a share of that of the task. With the full weight, a robot that
    # cannot swim yet would learn not to move
    energy_start: float = 0.1
    # shares of the steps: when the weight starts to grow, and how long it takes
    ramp: tuple[float, float] = (0.15, 0.25)
    # share of an agent's last episodes that must have succeeded for its weight to grow
    gate: float = 0.7
    # shares of the steps after which policies are kept, besides the last: stages of learning
    kept: tuple[float, ...] = (0.03, 0.1, 0.3)

    def __post_init__(self) -> None:
        s = self.settings
        for option, value, fits, expected in (
            ("--steps", self.steps, self.steps >= 1, "at least 1"),
            ("--envs", self.envs, self.envs >= 1, "at least 1"),
            ("--segment", self.segment, self.segment >= 1, "at least 1"),
            ("--updates-per-step", s.updates_per_step, s.updates_per_step > 0, "above 0"),
            ("--learning-rate", s.rate, s.rate > 0, "above 0"),
            ("--rate-end", s.rate_end, 0 <= s.rate_end <= 1, "from 0 to 1"),
            ("--batch", s.batch, s.batch >= 1, "at least 1"),
            ("--hidden", s.hidden, len(s.hidden) > 0 and min(s.hidden) >= 1, "at least 1 each"),
            ("--warm-up", s.warm_up, s.warm_up >= 0, "at least 0"),
            ("--entropy-start", s.entropy_start, s.entropy_start > 0, "above 0"),
            ("--noise-s", s.noise_s, s.noise_s >= 0, "at least 0"),
            ("--prices", s.prices, s.prices >= 1, "at least 1"),
            ("--average", s.average, 0 <= s.average < 1, "from 0 to below 1"),
            ("--discount", s.gamma, 0 <= s.gamma < 1, "from 0 to below 1"),
            ("--energy-start", self.energy_start, 0 <= self.energy_start <= 1, "from 0 to 1"),
        ):
            if not fits:
                raise InputError("train", option, str(value), expected)

    def grown(self, before: float, steps: int, more: int, success: float) -> float:
        """Growth of an energy weight, 0 to 1, ``more`` periods later, by the share of successes."""
        begin, length = self.ramp
        if steps < begin * self.steps or not success >= self.gate:
            return before
        return min(before + more / max(length * self.steps, 1.0), 1.0)

    def price(self, grown: float) -> float:
        """Weight of energy of an agent, given its growth."""
        return self.task.energy * (self.energy_start + (1 - self.energy_start) * grown)

    def content(self) -> dict[str, Any]:
        """All that determines the result, as JSON values."""
        fields = {k: v for k, v in asdict(self).items() if k not in ("task", "threads", "kept")}
        task = {k: v for k, v in vars(self.task).items() if k != "place"}
        return json.loads(json.dumps({**fields, "task": task}))  # type: ignore[no-any-return]


_CHAIN = replace(TASKS["chain"], energy=7e-4)
RECIPES: Mapping[str, Plan] = {
    "default": Plan(_CHAIN, settings=Settings(batch=128)),
    "paper": Plan(
        TASKS["point"], steps=1_000_000, envs=1, segment=50_000, energy_start=1.0, view=PAPER,
        settings=PLAIN,
    ),
    "fine": Plan(
        _CHAIN, energy_start=1.0, steps=200_000, envs=32, segment=32_000,
        settings=Settings(
            batch=128, rate=3e-4, rate_end=0.3, warm_up=20_000, entropy_target=(-2.0, -2.5),
            prices=1.0,
        ),
    ),
    "brief": Plan(
        replace(_CHAIN, energy=4e-4), energy_start=1.0, steps=160_000, envs=32, segment=160_000,
        settings=Settings(batch=64, hidden=(64, 64), prices=1.0, average=0.5),
    ),
}  # fmt: skip
"""Plans by the values of ``--recipe``, without seeds and simulator. "brief" continues from small
networks that were trained in another simulator, for each arm of a quick ablation. "fine" continues
from policies that nearly swim, such as in the fluid from those of the twin: full energy weight and
little noise from the start."""
QUICK: dict[str, Any] = {
    "steps": 300_000, "envs": 32, "segment": 60_000, "hidden": [64, 64], "updates_per_step": 0.12,
}  # fmt: skip
"""Settings of ``--quick``: minutes on two cores, in the twin. With 200 000 steps some seeds do not
swim yet with their mean action."""
_OF_PLAN = ("steps", "envs", "segment", "energy_start")
_OF_SETTINGS = {
    "updates_per_step": "updates_per_step", "learning_rate": "rate", "discount": "gamma",
    "rate_end": "rate_end", "batch": "batch", "hidden": "hidden", "warm_up": "warm_up",
    "entropy_start": "entropy_start", "entropy_target": "entropy_target", "noise_s": "noise_s",
    "prices": "prices", "average": "average",
}  # fmt: skip
_OFF = {"no_mirror": "mirror", "no_norm": "norm"}
OPTIONS = ("recipe", "task", "view", "energy_weight", *_OF_PLAN, *_OF_SETTINGS, *_OFF)
"""Options of a plan, as on the command line; None or False for the value of the recipe. Every field
in which the default recipe differs from the paper's has one."""
VIEWS = {"default": View(), "paper": PAPER}
"""Views by the values of ``--view``."""


def plan_of(options: Mapping[str, Any], **fields: Any) -> Plan:  # noqa: ANN401 - fields of Plan
    """A plan from some of ``OPTIONS`` and fields; what is missing or None is as in the recipe."""
    given = {
        name: value
        for name in OPTIONS
        if (value := options.get(name)) is not None and value is not False
    }
    recipe = given.get("recipe", "default")
    check_choice("train", "--recipe", recipe, RECIPES)
    plan = RECIPES[recipe]
    task = given.get("task", plan.task.name)
    check_choice("train", "--task", task, TASKS)
    settings = {field: given[name] for name, field in _OF_SETTINGS.items() if name in given}
    settings |= {field: False for name, field in _OFF.items() if name in given}
    for name in ("hidden", "entropy_target"):
        if name in settings:
            settings[name] = tuple(settings[name])
    if "view" in given:
        check_choice("train", "--view", given["view"], VIEWS)
        fields["view"] = VIEWS[given["view"]]
    plan = replace(
        plan,
        task=replace(TASKS[task], energy=given.get("energy_weight", plan.task.energy)),
        settings=replace(plan.settings, **settings),
        **{name: given[name] for name in _OF_PLAN if name in given},
        **fields,
    )
    if plan.segment < (shortest := plan.envs * plan.task.steps):
        expected = f"at least {shortest}, or no episode ends in one"
        raise InputError("train", "--segment", str(plan.segment), expected)
    return plan
