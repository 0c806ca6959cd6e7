"""A bench without hardware: virtual servos in a thread, and the command line that records them."""

import threading
import time
from contextlib import contextmanager

import numpy as np
from good_input import ROBOT

from sim2real.cli import main
from sim2real.hardware.buses import BUSES
from sim2real.hardware.recorder import priority
from sim2real.hardware.registers import model_named
from sim2real.hardware.virtual_bus import Law, VirtualBus, serve_terminal, serve_udp
from sim2real.hardware.virtual_servos import VirtualDynamixel, VirtualFeetech, VirtualLx

LAW = Law()
LIMITS = {"profile_velocity": 44, "profile_acceleration": 7}
LINK = ROBOT[ROBOT.rindex("[[links]]") : ROBOT.index("[[joints]]")]
JOINT = ROBOT[ROBOT.index("[[joints]]") : ROBOT.index("[servos")]


def robot_file(folder, joints):
    """The robot of the other tests, with so many joints."""
    path = folder / "robot.toml"
    more = (
        LINK.replace("tail", f"link{k}") + JOINT.replace("j1", f"j{k}")
        for k in range(2, joints + 1)
    )
    path.write_text(ROBOT + "".join(more))
    return path


def virtual(bus, servo_id, now, model=None, **servo):
    """A virtual servo on a bus."""
    if bus == "lx":
        return VirtualLx(servo_id, LAW, now, **servo)
    if bus == "dynamixel":
        return VirtualDynamixel(model_named(bus, "XL330-M288"), servo_id, LAW, now, **servo)
    return VirtualFeetech(model_named(bus, model or "STS3215"), servo_id, LAW, now, **servo)


def limit(servo, values=LIMITS):
    """Write a servo's registers, as its user did before."""
    for name, value in values.items():
        servo.put(name, value)


def limits(servo):
    return {name: servo.get(name) for name in LIMITS}


class Served:
    """Virtual servos 1 to ``count`` behind a port, until it is pulled."""

    def __init__(self, count, udp=False, echo=False, bus="lx", noise=0.0, loss=0.0, **servo):
        now, key = time.monotonic(), servo.pop("key", None)
        self.servos = [virtual(bus, k + 1, now, **servo) for k in range(count)]
        self._pulled, announced = threading.Event(), threading.Event()

        def announce(port):
            self.port = port
            announced.set()

        kind = BUSES[bus]
        line = {"echo": echo, "noise": noise, "loss": 0.0 if udp else loss, "fast": True}
        rng, baud = np.random.default_rng(0), kind.baud_rates[0]
        bus = VirtualBus(self.servos, kind.protocol, rng, baud=baud, **line)
        stop = self._pulled.is_set
        if udp:
            given = {"rng": np.random.default_rng(1), "key": key, "loss": loss}
            arguments = (bus, "127.0.0.1:0", announce, stop)
        else:
            given, arguments = {}, (bus, announce, stop)

        def serve():
            with priority():
                (serve_udp if udp else serve_terminal)(*arguments, **given)

        self._thread = threading.Thread(target=serve)
        self._thread.start()
        assert announced.wait(10)

    def pull(self):
        self._pulled.set()
        self._thread.join(10)


@contextmanager
def served(count=1, **given):
    servos = Served(count, **given)
    try:
        yield servos
    finally:
        servos.pull()


def record(folder, port, *more, joints=1, signal="sine"):
    """Exit status of ``sim2real record`` into ``folder/run.csv``."""
    ids = ",".join(str(k + 1) for k in range(joints))
    return main(
        ["record", signal, "--robot", str(robot_file(folder, joints)), "--port", port,
         "--ids", ids, "--out", str(folder / "run.csv"), *more]
    )  # fmt: skip


def refused(capsys, status, expected, *parts):
    """The one line of an error with ``parts``."""
    error = capsys.readouterr().err
    assert status == expected
    assert error.count("\n") == 1, error
    for part in parts:
        assert part in error
    return error


@contextmanager
def when_rows(path, rows, do):
    """Call ``do`` from a thread as soon as the recording at ``path`` has so many rows."""
    done = threading.Event()

    def watch():
        while not done.wait(0.01):
            if path.exists() and path.read_bytes().count(b"\n") > rows:
                do()
                return

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(10)
