"""The swim that tells apart the sets of effects that a diagnosis of swims left open.

As ``sim2real.design.rivals`` for servos, with signals whitened as in the diagnosis
(``signal_error``). Every coordinate has the variance of its imitation by the twin's error besides
that of its estimate. Commands are travelling waves (the gaits of a fish: Videler, Fish Swimming,
Chapman and Hall, 1993) and square waves, as of the swims on which that error was measured.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim.fluid.fluid import POOL_M
from sim.inference.coordinates import Coordinates, signals_at
from sim.inference.law_error import NEVER
from sim.inference.signal_error import Blocks
from sim.inference.swims import SUBSTEPS, PoseNoise, Swim, by_followed_twin
from sim.twin.twin import Twin
from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits, check_seconds, limits_of
from sim2real.design.plan import commands_without_angles
from sim2real.design.rivals import Request, RivalDesign, RivalObjective, forecast, root_of_inverse
from sim2real.design.search import best
from sim2real.diagnose.rival_sets import SwimRivals
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot


class SwimLimits:
    """Limits of the commands of a swim: those of each of its joints, of equal periods."""

    def __init__(self, joints: Sequence[CommandLimits]) -> None:
        self.joints = tuple(joints)
        self.period_s, self.rest_s = joints[0].period_s, joints[0].rest_s
        self.rest_rad = np.array([joint.rest_rad for joint in joints])
        self.reach_rad = np.array([joint.reach_rad for joint in joints])

    def within(self, commands: Array) -> Array:
        """Set-points (N, T, J) changed as little as needed to keep the limits of each joint."""
        pairs = zip(np.moveaxis(commands, 2, 0), self.joints, strict=True)
        return np.stack([joint.within(command) for command, joint in pairs], axis=2)


def draw(rng: np.random.Generator, count: int, limits: SwimLimits, seconds: float) -> Array:
    """Random commands of a swim within the limits, shape (N, T, J), of up to six parts each.

    A part is a wave that travels to the tail about a bias, which turns the robot, or, once in five
    times, a square wave of some joints together.
    """
    t, joints = limits.joints[0].times(seconds), len(limits.joints)
    shapes = np.zeros((count, t.size, joints))
    for shape in shapes:
        cuts = np.sort(rng.integers(1, t.size, int(rng.integers(0, 6))))
        for part in np.split(np.arange(t.size), cuts):
            if part.size < 2:
                continue
            since = t[part] - t[part[0]]
            if rng.random() < 0.2:
                level, hertz = rng.uniform(0.3, 0.6), rng.uniform(0.4, 0.7)
                square = level * np.sign(np.sin(2 * np.pi * hertz * since))
                shape[part] = square[:, None] * (rng.random(joints) < 0.7)
                continue
            hertz, size = np.exp(rng.uniform(*np.log([(0.7, 1.4), (0.45, 0.85)]).T))
            sizes = size * np.linspace(rng.uniform(0.4, 0.5), 1.0, joints)
            lags = rng.uniform(0.9, 1.3) * np.arange(joints)
            phase = 2 * np.pi * (hertz * since[:, None] + rng.random()) - lags
            bias = rng.choice([0.0, 0.38 * rng.uniform(-1.0, 1.0)])
            ramp = np.clip(since / 0.8, 0.0, 1.0)[:, None]
            shape[part] = ramp * (sizes * np.sin(phase) + bias)
    return limits.within(limits.rest_rad + limits.reach_rad * shapes)


def design_swim(
    rivals: SwimRivals,
    model: Model,
    robot: Robot,
    request: Request,
    *,
    drawn: int = 96,
    rounds: int = 4,
    threads: int = 2,
) -> RivalDesign:
    """The commands of a swim that leave the least expected entropy over the rival sets.

    The swim starts at rest in the middle of the pool, heading along x. ``drawn`` random swims are
    simulated in the twin with each set; the best are varied, in ``rounds`` batches of 16. ``model``
    is that of the diagnosis. An InputError if fewer than two sets are probable, or no swim keeps
    within the limits.
    """
    seconds, file = request.seconds, request.file
    if not request.leaves_open(rivals):
        none = "fewer than two probable sets of effects"
        raise InputError(file, "swim_rivals", none, "a diagnosis that leaves some open")
    if rivals.joint_sd_rad.size != len(robot.joints):
        found = f"a diagnosis of {rivals.joint_sd_rad.size} joints"
        raise InputError(file, "swim_rivals", found, f"the {len(robot.joints)} of {robot.name}")
    own = (limits_of(robot, joint.name) for joint in robot.joints)
    limits = SwimLimits([replace(one, period_s=rivals.period_s) for one in own])
    for joint in limits.joints:
        check_seconds(seconds, joint)
    objective = SwimObjective(rivals, model, robot, limits, threads=threads, file=file)
    result = best(
        objective, limits, seconds, rng=np.random.default_rng(request.seed), draw=draw, drawn=drawn,
        rounds=rounds, batch=16, progress=request.progress,
    )  # fmt: skip
    for limit, excess in objective.excesses(result.command[None]).items():
        if excess[0] > 0:
            found = f"swims that exceed the {limit}, of {result.evaluated} tried"
            raise InputError(robot.path or robot.name, "limits", found, "a shorter swim")
    body = forecast(objective, result.command, achieved=1.0)  # not measured for swims
    commands = commands_without_angles(
        limits.joints[0].times(seconds),
        {joint.joint: body.command[:, k] for k, joint in enumerate(limits.joints)},
        {"rivals": [body.content()]},
        {},
        kind="pool",
        medium="water",
    )
    start = "start: at rest in the middle of the pool, heading along x"
    return RivalDesign(commands, (body,), start, request.least)


class SwimObjective(RivalObjective):
    """Scores of the commands of a swim that begins in the middle of the pool, heading along x.

    A share of the probability is the same for all sets: the laws of the effects are approximations.
    Signals are linear in the coordinates about the likeliest set.
    """

    rivals: SwimRivals

    def __init__(
        self,
        rivals: SwimRivals,
        model: Model,
        robot: Robot,
        limits: SwimLimits,
        *,
        threads: int = 2,
        file: object = "diagnosis",
    ) -> None:
        super().__init__(rivals, uniform=0.3)
        self._robot, self._limits, self._threads = robot, limits, threads
        # with what the diagnosis has learned of the simulator's error
        learned: dict[str, float] = model.body.get("seems", {})
        c = Coordinates.of(robot, replace(model, body={**model.body, "effects": []}))
        seems = np.array([learned.get(column.name, 0.0) for column in c.columns])
        self._coordinates = replace(c, seems=seems)
        self._simulate = by_followed_twin(robot, threads=threads)
        self._points, self._roots = self._expansion(str(file))

    def excess(self, commands: Array) -> Array:
        """How much commands (N, T, J) exceed all limits together, shape (N,)."""
        return np.asarray(np.sum(list(self.excesses(commands).values()), axis=0))

    def excesses(self, commands: Array) -> dict[str, Array]:
        """By limit, how much the likeliest set exceeds it, relative or in m, each (N,); 0 if kept.

        The head stays a body's length from the walls: its path is known roughly. Torques are those
        of the servos' gains; set-points (N, T, J) arrive late.
        """
        tracks, period = self._tracks(commands), self._limits.period_s
        angles = tracks[:, :, 3:]
        room = np.array(POOL_M[:2]) / 2 - sum(link.length_m for link in self._robot.links)
        joints = self._limits.joints
        servos = [self._coordinates.model.joints[joint.joint] for joint in joints]
        late = [round(servo.latency_s / period) for servo in servos]
        # commands begin and end at the same rest
        sent = np.stack([np.roll(commands[:, :, k], n, axis=1) for k, n in enumerate(late)], axis=2)
        kp, kd = np.array([(servo.kp_Nm_per_rad, servo.kd_Nms_per_rad) for servo in servos]).T
        torque = kp * (sent - angles) - kd * np.gradient(angles, period, axis=1)
        most, rms = np.array([(j.torque_Nm, j.rms_torque_Nm) for j in joints]).T
        found = {
            "walls of the pool": np.max(np.abs(tracks[:, :, :2]) - room, axis=(1, 2)),
            "max_torque_Nm": np.max(np.abs(torque).max(axis=1) / most - 1, axis=1),
            "rms torque": np.max(np.sqrt(np.mean(torque**2, axis=1)) / rms - 1, axis=1),
        }
        # a robot that the simulation loses exceeds every limit
        return {k: np.nan_to_num(np.maximum(x, 0.0), nan=np.inf) for k, x in found.items()}

    def predictions(self, commands: Array) -> Iterator[tuple[Array, Array, float]]:
        """For each swim whitened predictions (M, n), spreads (M, F, n), and the trusted share."""
        period, rivals, M = self._limits.period_s, self.rivals, self.probability.size
        t = period * np.arange(commands.shape[1], dtype=np.float64)
        pose_noise = PoseNoise(rivals.pose_sd, rivals.pose_lag_s)
        noise_sd, blocks = np.concatenate([np.zeros(3), rivals.joint_sd_rad]), None
        for command, track in zip(commands, self._tracks(commands), strict=True):
            swim = Swim(
                "next", t, command, track[0, :3], np.zeros(track.shape), track[:, :3], noise_sd,
                pose_noise=pose_noise,
            )  # fmt: skip
            signals = signals_at(self._coordinates, swim, self._points, self._simulate)
            blocks = Blocks.of(swim) if blocks is None else blocks
            blocks = replace(blocks, power=blocks.about(signals[0]))
            rows = blocks.weighted(signals - signals[0], blocks.weights(rivals.shares)).T
            base, moved = np.split(rows[M:], 2)
            yield rows[:M], self._roots @ (moved - base), 1 / rivals.temperature

    def _tracks(self, commands: Array) -> Array:
        """Tracks of the likeliest set in the pool, shape (N, T, 3 + J), from standstill."""
        model, N = self._coordinates.model_at(self._points[0]), len(commands)
        twin = Twin(self._robot, model, n_envs=N, substeps=SUBSTEPS, threads=self._threads)
        return twin.swum(commands, np.zeros((N, 3)), np.arange(N))

    def _expansion(self, file: str) -> tuple[Array, Array]:
        """Points (M + 2 C, F): sets, and steps of C coordinates; roots of variances (M, G, C)."""
        c, sets, M = self._coordinates, self.rivals.sets, len(self.rivals.sets)
        at, free = np.tile(c.nominal, (M, 1)), []
        for i, one in enumerate(sets):
            for name in one.coordinates:
                if name not in c.place:
                    found, expected = f"the coordinate {name}", f"one of {self._robot.name}"
                    raise InputError(file, f"swim_rivals.sets[{i}].coordinates", found, expected)
            free.append([c.place[name] for name in one.coordinates])
            at[i, free[i]] = list(one.coordinates.values())
        stated = [self.rivals.imitation.get(column.name, 0.0) for column in c.columns]
        least = NEVER * c.each("step")
        used = np.flatnonzero(np.array(stated) > 2 * least)
        used = np.unique(np.concatenate([used, *free])).astype(int)
        around, base = c.about(at[0])
        own = max(len(columns) for columns in free)
        roots = np.zeros((M, own + used.size, used.size))
        for i, one in enumerate(sets):
            places = np.searchsorted(used, free[i])
            roots[i][: len(places), places] = root_of_inverse(one.information).T
            variance = np.maximum(stated, least)[used] ** 2
            of_effect = [n for n in places if c.columns[used[n]].effect is not None]
            variance[of_effect] += np.square(self.rivals.relative * at[i, used[of_effect]])
            roots[i, own:] = np.diag(np.sqrt(variance))
        points = np.vstack([at, around[base[used]], around[used + 1]])
        return c.clipped(points), roots / c.steps(at[0])[used]
