"""``sim2real swim``: a policy drives the robot, or a virtual one, to a target."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import numpy as np
from tqdm import tqdm

from rl.deploy.link import Link
from rl.deploy.pilot import ANSWER_S, Pilot, Track, swim
from rl.deploy.policy import Policy, read_npz
from sim2real.arrays import Array
from sim2real.commands.command import numbers
from sim2real.errors import InputError
from sim2real.hardware.radio import shared_key
from sim2real.hardware.recorder import interruption
from sim2real.output import check_writable, provenance
from sim2real.recording import POSE, Recording, write_recording
from sim2real.robot import Robot, read_robot

FEWEST_ROWS = 2
_BAR = "{desc}: {percentage:3.0f}%|{bar}| {n:.1f} of {total:.0f} s"


def run(options: argparse.Namespace) -> int:
    """Swim and write a pool recording; 1 if the swim was stopped early, else 0."""
    place = "X,Y in m, as 1.2,-0.4"
    target = np.array(numbers("--target", options.target, float, place, count=2))
    if not 0 < options.seconds <= 3600:
        raise InputError("--seconds", "", f"{options.seconds:g}", "more than 0, to 3600")
    if options.out is not None:
        if options.out.suffix != ".csv":
            raise InputError("--out", "", str(options.out), "a file name ending in .csv")
        check_writable(options.out)
        check_writable(options.out.with_suffix(".json"))
    key = shared_key(options.key_file)
    if options.policy.suffix == ".zip":  # which needs PyTorch
        from rl.deploy.export import read_zip

        policy = read_zip(options.policy)
    else:
        policy = read_npz(options.policy)
    pilot = Pilot(policy, target, options.seconds)
    with (
        interruption() as stop,
        _robot(options, policy, stop, key) as url,
        Link(url, len(policy.joints), key) as link,
        tqdm(total=options.seconds, desc="swim", bar_format=_BAR, disable=None) as bar,
    ):
        track = swim(link, pilot, interrupted=stop, progress=bar.update)
        if track is None:
            strange = f", only {link.strange} strange datagrams" if link.strange else ""
            failure = f"no answer from {url} in {ANSWER_S:g} s{strange}"
            expected = "a robot with the protocol of rl/deploy/link.py, this key and no other pilot"
            raise InputError("--port", "", failure, expected)
    written = "nothing written"
    if options.out is not None and len(track.t) >= FEWEST_ROWS:
        write_recording(_recording(options, policy, target, track), options.out)
        written = f"{len(track.t)} rows in {options.out}"
    outcome = f"closest {track.closest_m:.3f} m" if np.isfinite(track.closest_m) else "not started"
    if track.stopped:
        line = f"sim2real swim: {track.stopped}; {outcome}; sent to rest; {written}"
        print(line, file=sys.stderr)
        return 1
    if track.reached_s is not None:
        outcome = f"target reached in {track.reached_s:.2f} s"
    print(f"{outcome}; {written}")
    return 0


@contextmanager
def _robot(
    options: argparse.Namespace, policy: Policy, stop: Callable[[], bool], key: bytes | None
) -> Iterator[str]:
    """URL of the robot; a virtual one, or one on a bus, runs until the block ends."""
    if options.bus is not None:
        _needs(options, "port", "ids", "robot", "pose", why="--bus")
        with _on_bus(options, policy, stop, key) as url:
            yield url
    elif options.virtual:
        from rl.deploy.robots import virtual_robot
        from sim.twin.twin import Twin
        from sim2real.model import read_model

        _needs(options, "robot", "model", why="--virtual")
        robot = _described(options, policy)
        with virtual_robot(Twin(robot, read_model(options.model), threads=1), key) as url:
            yield url
    elif options.port is None:
        raise InputError("--port", "", "nothing", "udp://HOST:PORT, --bus or --virtual")
    else:
        yield options.port


@contextmanager
def _on_bus(
    options: argparse.Namespace, policy: Policy, stop: Callable[[], bool], key: bytes | None
) -> Iterator[str]:
    """URL of a robot whose servos are on a bus of this computer."""
    from rl.deploy.robots import bus_robot
    from sim2real.hardware.buses import bus_class, connection, ids_of
    from sim2real.hardware.mounting import places
    from sim2real.hardware.recorder import mounted, priority
    from sim2real.hardware.servo_bus import Stopped

    robot = _described(options, policy)
    ids = ids_of(options.ids, bus_class(options.bus))
    wired = places(robot, ids, reverse=options.reverse)
    rest = np.clip(0.0, policy.low, policy.high).astype(np.float64)
    try:
        with (
            priority(),
            connection(options.bus, options.port, options.baud) as link,
            bus_robot(
                link, mounted(link.bus, robot, wired), rest, options.pose,
                hottest_C=options.max_temperature, interrupted=stop, key=key,
            ) as (url, driven),
        ):  # fmt: skip
            yield url
            if driven.stopped:
                print(f"sim2real swim: {driven.stopped}", file=sys.stderr)
    except Stopped as error:
        raise InputError("--port", "", str(error), "servos that answer") from None


def _needs(options: argparse.Namespace, *names: str, why: str) -> None:
    for name in names:
        if getattr(options, name) is None:
            raise InputError(f"--{name}", "", "nothing", f"it, for {why}")


def _described(options: argparse.Namespace, policy: Policy) -> Robot:
    """The robot, whose joints are those of the policy."""
    robot = read_robot(options.robot)
    names = tuple(joint.name for joint in robot.joints)
    if names != policy.joints:
        expected = f"those of the policy, {', '.join(policy.joints)}"
        raise InputError(options.robot, "joints", ", ".join(names), expected)
    return robot


def _recording(
    options: argparse.Namespace, policy: Policy, target: Array, track: Track
) -> Recording:
    virtual = "Simulated by the twin, not measured: " if options.virtual else ""
    columns = dict(zip(POSE, track.pose.T, strict=True))
    columns |= {"device_t_s": track.device_t, "inference_s": track.inference_s}
    inputs = [path for path in (options.policy, options.robot, options.model) if path is not None]
    return Recording(
        name=options.out.stem,
        kind="pool",
        joints=policy.joints,
        t=track.t,
        command=track.command,
        position=track.joint,
        medium="water",
        source=f"{virtual}'sim2real swim' with {options.policy.name}.",
        columns=columns,
        metadata={
            "swim": {
                "target_m": target.tolist(),
                "reached_s": track.reached_s,
                "closest_m": track.closest_m if np.isfinite(track.closest_m) else None,
                "stopped": track.stopped,
            },
            "ended": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "provenance": provenance(inputs, options.seed),
            "simulated": bool(options.virtual),
        },
    )
