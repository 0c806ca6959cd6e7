"""The design of the next recording: commands of every joint, and what they are expected to tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.arrays import Array
from sim2real.design.information import Information, prior_of
from sim2real.design.limits import check_seconds, holding, limits_of
from sim2real.design.search import SearchResult, best, part
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.importers.options import loads_of
from sim2real.inference.normal import Z90
from sim2real.model import Model
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODEL, SHEET = "model", "data sheet"


@dataclass(frozen=True)
class NextRecording(NotebookDisplay):
    """Commands to record next; subclasses state what they are expected to tell."""

    commands: Recording  # without measured angles; its metadata state what is expected
    # command line, versions, seed and SHA-256 of the inputs
    provenance: Mapping[str, Any] = field(default_factory=dict, kw_only=True)

    @property
    def t(self) -> Array:
        """Times of the set-points in s, shape (T,)."""
        return self.commands.t

    def recording(self, name: str = "next") -> Recording:
        """The commands as a recording without measured angles, and what they are to tell."""
        metadata = {**self.commands.metadata, "provenance": dict(self.provenance)}
        return replace(self.commands, name=name, metadata=metadata)

    def plot(self, joint: str | None = None) -> Figure:
        """Command of one joint, by default the first, and its precision over time."""
        figure: Figure = from_report("design_plot.design_figure")(self, joint)
        return figure


def commands_without_angles(
    t: Array,
    commands: Mapping[str, Array],
    metadata: Mapping[str, Any],
    loads: Mapping[str, Load],
    **fields: Any,  # noqa: ANN401
) -> Recording:
    """Commands (T,) by joint as a recording without angles; ``fields`` are the recording's."""
    command = np.stack(list(commands.values()), axis=1)
    return Recording(
        "next",
        joints=tuple(commands),
        t=t,
        command=command,
        position=np.full(command.shape, np.nan),
        source="Commands to record next, by 'sim2real design'.",
        metadata=dict(metadata),
        loads={name: load for name, load in loads.items() if load is not PER_INERTIA},
        **fields,
    )


@dataclass(frozen=True)
class JointDesign:
    """The commands of one joint and what is expected of them."""

    information: Information  # the objective: the prior of the servo, and the limits
    found: SearchResult  # the result of the search
    origin: str  # what the prior comes from, ``"model"`` or ``"data sheet"``

    @cached_property
    def expected(self) -> dict[str, float]:
        """Half-width of the expected 90 % interval of each parameter, relative to its value.

        The geometric mean over the servos of the prior.
        """
        return dict(zip(self.information.prior.names, self.over_time(1)[0].tolist(), strict=True))

    @property
    def determined(self) -> dict[str, bool]:
        """Whether each parameter's interval is at most half as wide as before the recording.

        Before, it is that of the prior, or the parameter itself where there is none.
        """
        before = np.minimum(Z90 * self.information.prior.sd, 1.0)
        return {
            name: bool(width < 0.5 * most)
            for (name, width), most in zip(self.expected.items(), before, strict=True)
        }

    def over_time(self, parts: int) -> Array:
        """Expected half-widths after each of some equal parts of the command, shape (parts, F)."""
        command = self.found.command
        ends = np.linspace(0, command.size, parts + 1)[1:].astype(int)
        widths = [self.information.precision(command[None, :end])[0][0] for end in ends]
        return np.exp([np.log(width).mean(axis=0) for width in widths])

    def content(self) -> dict[str, Any]:
        """What is expected, for the JSON file."""
        determined, expected = self.determined, dict[str, dict[str, Any]]()
        prior = self.information.prior
        values = prior.values[0].tolist()
        for (name, width), value in zip(self.expected.items(), values, strict=True):
            expected[name] = {"relative_half_width": width, "determined": determined[name]}
            if self.origin == MODEL:
                expected[name]["interval"] = [value * (1 - width), value * (1 + width)]
        torque = float(self.information.precision(self.found.command[None])[1].mean())
        return {
            "belief": self.origin,
            "expected": expected,
            "noise_rad": prior.white_rad,
            "angle_error_rad": prior.angle_rad,
            "rms_torque_Nm": None if prior.load is PER_INERTIA else torque,
            "commands_compared": self.found.evaluated,
            "range_rad": list(self.information.limits.position_rad),
        }


@dataclass(frozen=True)
class Design(NextRecording):
    """Commands that determine the servos' parameters best."""

    joints: Mapping[str, JointDesign]  # the design of each joint


def design(
    robot: Robot,
    model: Model | None = None,
    *,
    seconds: float = 30.0,
    loads: Mapping[str, Load] | None = None,
    seed: int = 0,
    drawn: int = 128,
    rounds: int = 64,
    progress: Callable[[float], None] = lambda share: None,
) -> Design:
    """Commands that determine the servos best, within the limits of the robot.

    A joint moves where its servo can hold the load, see ``limits.holding``. Without a model servos
    are as their data sheets say; loads are by default the model's. In a recording of ``seconds``,
    ``drawn`` random commands are compared and the best varied in ``rounds``.
    """
    limits = {name: limits_of(robot, name) for name in _designed_joints(robot, model)}
    for joint in limits.values():
        check_seconds(seconds, joint)
    joints = {}
    for k, (name, joint) in enumerate(limits.items()):
        prior = prior_of(robot, model, joint, load=(loads or {}).get(name), seed=seed)
        information = Information(prior, holding(joint, prior.load, robot))
        found = best(
            information, information.limits, seconds, rng=np.random.default_rng([seed, k]),
            drawn=drawn, rounds=rounds, progress=part(progress, k, len(limits)),
        )  # fmt: skip
        joints[name] = JointDesign(information, found, MODEL if model else SHEET)
    commands = commands_without_angles(
        next(iter(limits.values())).times(seconds),
        {name: joint.found.command for name, joint in joints.items()},
        {"design": {name: joint.content() for name, joint in joints.items()}},
        {name: joint.information.prior.load for name, joint in joints.items()},
        kind="servo",
    )
    return Design(commands, joints)


def stated_loads(
    robot: Robot, model: Model | None, inertia: Sequence[str] | None, pendulum: Sequence[str] | None
) -> dict[str, Load]:
    """Loads by joint from ``J=KGM2`` and ``J=KG,M``, see ``importers.options.loads_of``."""
    joints = _designed_joints(robot, model)
    if not joints:
        found = f"the joints {', '.join(model.joints) if model else ''}"
        known = ", ".join(joint.name for joint in robot.joints)
        raise InputError("model", "joints", found, f"some of the robot's: {known}")
    return loads_of(inertia, pendulum, joints)


def _designed_joints(robot: Robot, model: Model | None) -> list[str]:
    """Joints of the robot that the model has; all of them without a model."""
    return [j.name for j in robot.joints if model is None or j.name in model.joints]
