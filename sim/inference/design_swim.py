"""The swim that tells apart the sets of effects that a diagnosis of swims left open.

As ``sim2real.design.rivals`` for servos, with signals whitened as in the diagnosis
(``signal_error``). The error of the twin imitates effects, differently in each swim: every
coordinate has the variance of that imitation besides that of its estimate, so that drag, friction
or added mass that the error imitates do not count as distinguished. Commands are travelling waves
(the gaits of a fish: Videler, Fish Swimming, Chapman and Hall, 1993) and square waves, in the
ranges of the swims on which that error was measured (``reports/design/swims.md``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from sim.fluid.fluid import POOL_M
from sim.inference.coordinates import Coordinates, signals_at
from sim.inference.law_error import NEVER
from sim.inference.pose_noise import PoseNoise
from sim.inference.signal_error import Blocks
from sim.inference.swims import SUBSTEPS, Swim, by_followed_twin
from sim.twin.twin import Twin
from sim2real.arrays import Array
from sim2real.design.contexts import AS_IT_IS
from sim2real.design.limits import CommandLimits, check_seconds, limits_of
from sim2real.design.rivals import distances, remaining_entropy
from sim2real.design.search import best
from sim2real.design.tell_apart import Request, RivalDesign, forecast
from sim2real.diagnose.rival_sets import entropy
from sim2real.diagnose.swim_rivals import SwimRivals
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.recording import Recording
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
    """Random commands of a swim within the limits, shape (N, T, J)."""
    t, joints = limits.joints[0].times(seconds), len(limits.joints)
    shapes = np.array([_swim(rng, t, joints) for _ in range(count)])
    return limits.within(limits.rest_rad + limits.reach_rad * shapes)


def _swim(rng: np.random.Generator, t: Array, joints: int, *, most: int = 6) -> Array:
    """Up to ``most`` parts of random lengths, relative to the reach of the joints, (T, J)."""
    cuts = np.sort(rng.integers(1, t.size, int(rng.integers(0, most))))
    out = np.zeros((t.size, joints))
    for part in np.split(np.arange(t.size), cuts):
        if part.size > 1:
            gait = _square if rng.random() < 0.2 else _wave
            out[part] = gait(rng, t[part] - t[part[0]], joints)
    return out


def _wave(rng: np.random.Generator, t: Array, joints: int) -> Array:
    """A wave that travels to the tail about a random bias, which turns the robot, shape (T, J)."""
    hertz, size = np.exp(rng.uniform(*np.log([(0.7, 1.4), (0.45, 0.85)]).T))
    sizes = size * np.linspace(rng.uniform(0.4, 0.5), 1.0, joints)
    lags = rng.uniform(0.9, 1.3) * np.arange(joints)
    phase = 2 * np.pi * (hertz * t[:, None] + rng.random()) - lags
    bias = rng.choice([0.0, 0.38 * rng.uniform(-1.0, 1.0)])
    ramp = np.clip(t / 0.8, 0.0, 1.0)[:, None]
    return np.asarray(ramp * (sizes * np.sin(phase) + bias))


def _square(rng: np.random.Generator, t: Array, joints: int) -> Array:
    """A square wave of some joints together, shape (T, J)."""
    level = rng.uniform(0.3, 0.6) * np.sign(np.sin(2 * np.pi * rng.uniform(0.4, 0.7) * t))
    return np.asarray(level[:, None] * (rng.random(joints) < 0.7))


def usual(limits: SwimLimits, seconds: float) -> Array:
    """Swims that any robot can make, after the rest at the start, shape (5, T, J).

    Slow and strong strokes, quick and weak ones, a circle, strokes before coasting, and squares.
    """
    t = limits.joints[0].times(seconds)[:, None] - limits.rest_s
    place = np.arange(len(limits.joints))
    shape = np.linspace(0.28, 0.6, place.size)
    swims = []
    for hertz, size, turn, until_s in (
        (0.7, 1.1, 0.0, 12.0), (1.5, 0.5, 0.0, 12.0), (1.0, 0.9, 0.25, 12.0), (1.2, 1.0, 0.0, 6.0)
    ):  # fmt: skip
        wave = size * shape * np.sin(2 * np.pi * hertz * t - 1.1 * place) + turn
        swims.append(np.clip(np.clip(t / 0.8, 0, 1) * (t < until_s) * wave, -0.76, 0.76))
    swims.append(np.tile(0.4 * np.sign(np.sin(np.pi * t)), (1, place.size)))
    return np.where(t < 0, 0.0, swims)


@dataclass(frozen=True)
class SwimDesign(RivalDesign):
    """A swim to make next, from standstill in the middle of the pool, heading along x."""

    # the joints that ``command`` of the forecast moves, in its order
    moved_joints: tuple[str, ...] = field(default=())

    @property
    def setting(self) -> str:
        """Where the swim starts, in one line."""
        return "start: at rest in the middle of the pool, heading along x"

    def recording(self, name: str = "next") -> Recording:
        """The commands as a recording without measurements, and what they are to tell."""
        (body,) = self.joints
        return Recording(
            name=name,
            kind="pool",
            joints=self.moved_joints,
            t=self.t,
            command=body.command,
            position=np.full(body.command.shape, np.nan),
            medium="water",
            source="Commands to swim next, by 'sim2real design'.",
            metadata=self.statement,
        )


def design_swim(
    rivals: SwimRivals,
    model: Model,
    robot: Robot,
    request: Request,
    *,
    drawn: int = 96,
    rounds: int = 4,
    threads: int = 2,
) -> SwimDesign:
    """The commands of a swim that leave the least expected entropy over the rival sets.

    Random swims, and those of ``usual``, are simulated in the twin with each set; the best are
    varied.

    Args:
        rivals: The sets that are open.
        model: The model of the diagnosis: servos, and the twin's law and error.
        robot: The robot, for the limits of its commands.
        request: Duration, seed, and which sets count.
        drawn: Number of random swims.
        rounds: Number of batches of 16 variations of the best.
        threads: CPU threads.

    Raises:
        InputError: If fewer than two sets are probable, the robot is another one, the duration is
            too short, or no swim that was tried keeps within the limits.
    """
    seconds, file = request.seconds, request.file
    if not request.leaves_open(rivals):
        none = "fewer than two probable sets of effects"
        raise InputError(file, "swim_rivals", none, "a diagnosis that leaves some open")
    if rivals.joint_sd_rad.size != len(robot.joints):
        found = f"a diagnosis of {rivals.joint_sd_rad.size} joints"
        raise InputError(file, "swim_rivals", found, f"the {len(robot.joints)} of {robot.name}")
    limits = SwimLimits(
        [replace(limits_of(robot, one.name), period_s=rivals.period_s) for one in robot.joints]
    )
    for joint in limits.joints:
        check_seconds(seconds, joint)
    objective = SwimObjective(rivals, model, robot, limits, threads=threads, file=file)
    result = best(
        objective, limits, seconds, rng=np.random.default_rng(request.seed), draw=draw, drawn=drawn,
        rounds=rounds, batch=16, start=usual(limits, seconds), progress=request.progress,
    )  # fmt: skip
    for limit, excess in objective.excesses(result.command[None]).items():
        if excess[0] > 0:
            found = f"swims that exceed the {limit}, of {result.evaluated} tried"
            raise InputError(robot.path or robot.name, "limits", found, "a shorter swim")
    names = tuple(joint.joint for joint in limits.joints)
    body = forecast(objective, result.command, achieved=1.0)  # not measured for swims
    return SwimDesign(AS_IT_IS, (body,), request.least, moved_joints=names)


class SwimObjective:
    """Scores of the commands of a swim that begins in the middle of the pool, heading along x.

    A share ``uniform`` of the probability is distributed evenly among the sets: the laws of the
    effects are approximations, so that no probability of a set is certain. The model has the
    servos, and the twin's law and its error where the diagnosis has learned them.

    Attributes:
        probability: Probabilities of the M sets, shape (M,).

    Raises:
        InputError: If the robot lacks a coordinate of a set.
    """

    def __init__(
        self,
        rivals: SwimRivals,
        model: Model,
        robot: Robot,
        limits: SwimLimits,
        *,
        uniform: float = 0.3,
        threads: int = 2,
        file: object = "diagnosis",
    ) -> None:
        self.rivals, self._robot, self._limits, self._threads = rivals, robot, limits, threads
        p = np.array([one.probability for one in rivals.sets])
        self.probability = (1 - uniform) * p / p.sum() + uniform / p.size
        # with what the diagnosis has learned of the simulator's error
        learned: dict[str, float] = model.body.get("seems", {})
        c = Coordinates.of(robot, replace(model, body={**model.body, "effects": []}))
        seems = np.array([learned.get(column.name, 0.0) for column in c.columns])
        self._coordinates = replace(c, seems=seems)
        self._simulate = by_followed_twin(robot, threads=threads)
        self._points, self._vectors = self._expansion(str(file))
        self._blocks: Blocks | None = None

    def __call__(self, commands: Array, *, penalty: float = 10.0) -> Array:
        """Scores of set-points (N, T, J) in rad, shape (N,); -inf where a simulation diverges.

        Minus the entropy that remains, in nats, or that before the swim, less the penalty, where
        limits are exceeded: ``penalty`` for a torque of twice what is allowed or a path 1 m
        outside.
        """
        tracks = self._tracks(commands)
        excess = np.sum(list(self.excesses(commands, tracks).values()), axis=0)
        scores = -entropy(self.probability) - penalty * excess
        for n in np.flatnonzero(excess == 0.0):
            scores[n] = -remaining_entropy(self.probability, self._apart(commands[n], tracks[n]))
        return np.asarray(scores)

    def excesses(self, commands: Array, tracks: Array | None = None) -> dict[str, Array]:
        """By limit, how much the likeliest set exceeds it, relative or in m, each (N,); 0 if kept.

        The head stays a body's length from the walls: its path is known roughly. Torques are those
        of the servos' gains; set-points (N, T, J) arrive late. ``tracks`` is from ``_tracks``.
        """
        tracks = self._tracks(commands) if tracks is None else tracks
        angles, period = tracks[:, :, 3:], self._limits.period_s
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

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        tracks = self._tracks(commands)
        return np.array([self._apart(*pair) for pair in zip(commands, tracks, strict=True)])

    def _tracks(self, commands: Array) -> Array:
        """Tracks of the likeliest set in the pool, shape (N, T, 3 + J), from standstill."""
        model = self._coordinates.model_at(self._points[0])
        twin = Twin(
            self._robot, model, n_envs=len(commands), substeps=SUBSTEPS, threads=self._threads
        )
        twin.reset(pose=np.zeros((len(commands), 3)))
        first = twin.track()[:, None]
        track = twin.swim(commands[:, :-1], which=np.arange(len(commands)))
        return np.concatenate([first, track], axis=1)

    def _apart(self, command: Array, track: Array) -> Array:
        """Distances of all pairs of sets, shape (M, M), for one command (T, J) and its track."""
        rows = self._whitened(command, track)
        M = self.probability.size
        if not np.isfinite(rows).all():
            return np.full((M, M), np.nan)
        products = self._vectors.T @ (rows @ rows.T) @ self._vectors
        return np.asarray(distances(products[None], M)[0]) / self.rivals.temperature

    def _whitened(self, command: Array, track: Array) -> Array:
        """Signals of all points less those of the first, transformed and whitened, (R, T K)."""
        period, rivals = self._limits.period_s, self.rivals
        swim = Swim(
            "next", period * np.arange(len(command), dtype=np.float64), command, track[0, :3],
            np.zeros(track.shape), np.concatenate([np.zeros(3), rivals.joint_sd_rad]),
            pose=track[:, :3], pose_noise=PoseNoise(rivals.pose_sd, rivals.pose_lag_s),
        )  # fmt: skip
        signals = signals_at(self._coordinates, swim, self._points, self._simulate)
        if self._blocks is None or self._blocks.seen.shape != track.shape:
            self._blocks = Blocks.of(swim)
        blocks = replace(self._blocks, power=self._blocks.about(signals[0]))
        weights = blocks.weights(rivals.shares)
        return blocks.weighted(signals - signals[0], weights).T

    def _expansion(self, file: str) -> tuple[Array, Array]:
        """Points to simulate, and how predictions and their spreads follow from their signals.

        Derivatives by a coordinate are taken at the likeliest set that has it, and at the likeliest
        of all for effects that none has.

        Returns:
            Points (R, F), first those of the M sets; coefficients of the differences of their
            signals from those of the first: the predictions of the sets, then for each set its
            derivatives times a root of the covariance, shape (R, M + M C).
        """
        c, sets, M = self._coordinates, self.rivals.sets, len(self.rivals.sets)
        at, free = np.tile(c.nominal, (M, 1)), []
        for i, one in enumerate(sets):
            for name in one.coordinates:
                if name not in c.place:
                    found, expected = f"the coordinate {name}", f"one of {self._robot.name}"
                    raise InputError(file, f"swim_rivals.sets[{i}].coordinates", found, expected)
            free.append([c.place[name] for name in one.coordinates])
            at[i, free[i]] = list(one.coordinates.values())
        least = NEVER * c.each("step")
        stated = [self.rivals.imitation.get(column.name, 0.0) for column in c.columns]
        imitation = np.maximum(stated, least)
        used = sorted({*np.flatnonzero(imitation > 2 * least).tolist(), *chain(*free)})
        points, changed = list(at), []
        for k in used:
            i = next((i for i in range(M) if k in free[i]), 0)
            around, base = c.about(at[i])
            moved = len(points)
            points.append(around[k + 1])
            if base[k]:
                points.append(around[base[k]])
            changed.append((moved, moved + 1 if base[k] else i, c.steps(at[i])[k]))
        derivatives = np.zeros((len(points), len(used)))
        for n, (after, before, step) in enumerate(changed):
            derivatives[after, n], derivatives[before, n] = 1 / step, -1 / step
        vectors = [np.eye(len(points), M)]
        for i, one in enumerate(sets):
            variance = imitation**2
            effects = [k for k in free[i] if c.columns[k].effect is not None]
            variance[effects] += np.square(self.rivals.relative * at[i, effects])
            covariance = np.diag(variance)
            covariance[np.ix_(free[i], free[i])] += np.linalg.inv(one.information)
            vectors.append(derivatives @ np.linalg.cholesky(covariance[np.ix_(used, used)]))
        return c.clipped(np.array(points)), np.hstack(vectors)
