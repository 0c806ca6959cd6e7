"""A bench without hardware: virtual servos in a thread, and the command line that records them."""

import threading
import time
from contextlib import contextmanager

import numpy as np

from sim2real.cli import main
from sim2real.hardware.buses import BUSES
from sim2real.hardware.process import priority
from sim2real.hardware.servo_models import model_named
from sim2real.hardware.virtual_bus import Law, VirtualBus
from sim2real.hardware.virtual_link import serve_terminal, serve_udp
from sim2real.hardware.virtual_servos import VirtualDynamixel, VirtualFeetech, VirtualLx

LAW = Law()
LIMITS = {"profile_velocity": 44, "profile_acceleration": 7}
HEAD = """
name = "bench"
[servos.lx824]
max_torque_Nm = 1.67
no_load_speed_rad_s = 5.24
position_step_rad = 0.00419
"""
LINK = """
[[links]]
name = "link"
mass_kg = 0.5
length_m = 0.2
width_m = 0.1
height_m = 0.1
"""
JOINT = """
[[joints]]
name = "j{k}"
servo = "lx824"
limits_rad = [-0.8, 0.8]
"""


def robot_file(folder, joints):
    path = folder / "robot.toml"
    turned = "".join(JOINT.format(k=k + 1) for k in range(joints))
    path.write_text(HEAD + LINK * (joints + 1) + turned)
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
            where = ("127.0.0.1", 0)
            given = {"rng": np.random.default_rng(1), "key": key, "loss": loss}
            arguments = (bus, where, announce, stop)
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
