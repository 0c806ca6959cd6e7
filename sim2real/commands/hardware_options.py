"""Command-line options of commands that talk to servos and cameras, and to those who play them."""

from __future__ import annotations

from sim2real.commands.command import Command

_PORT = "--port URL{}: port: /dev/ttyUSB0, socket://HOST:PORT or udp://HOST:PORT"
_BUS = """
--bus NAME = lx: protocol of the servos: lx, dynamixel (2.0) or feetech
--baud N: bits per second (default 115200 for lx, 1000000 for the others)
"""
_DRIVEN = """
--seconds X = 30.0: duration, s
--max-temperature X = 65.0: stop when a servo is hotter, degrees Celsius
--overwrite: replace existing files
"""
_RECORD = """
signal SIGNAL: steps, sine, square, chirp, multisine, or a file of commands (COMMANDS.csv)
--robot TOML!: the robot, for the limits of its joints (robot.toml)
--ids LIST: id of the servo of each joint, such as 1,2,3
--out CSV: recording to write
--joints JOINT+: joints to move (default: all)
--trim LIST: offset of each servo in ticks, such as 4,0,-2: position at angle 0 minus that at the
    centre of the servo
--reverse JOINT+: joints whose servo turns in the opposite direction
--inertia LIST: inertia of the load on each joint, kg m2
--medium air|water = air: what the robot moves in
--source TEXT: source of the recording, stored with it
--amplitude X: amplitude, rad (default: 0.52 for sine and square, as in the paper, 3/4 of what the
    limits allow for others)
--frequency X: frequency of sine and square, Hz (default: 1 for sine, 0.5 for square)
--band X*2 = 0.1,2.0: lowest and highest frequency of chirp and multisine, Hz
--dry-run: show the signal and move nothing
--plot PNG: plot of the signal to write
"""
_BENCH = """
--ids LIST!: ids of the servos, such as 1 or 1,2,3
--out FOLDER = bench: folder for recording, robot, model and page
--mass LIST: mass of the load on each servo, kg (asked for by default)
--arm LIST: distance of that mass from each shaft, m (with --mass)
--inertia LIST: inertia of the load on each servo, kg m2, instead of --mass and --arm
--unknown-load: identify per unit of inertia, ask nothing
--shaft horizontal|vertical = horizontal: horizontal: the mass hangs straight down at the centre of
    the servo; vertical: no gravity
--reach X = 0.6: largest deviation from the centre, rad
--robot TOML: limits and data sheet, one joint per servo (robot.toml); by default those of the
    servo's model are written to the folder
"""
_VIRTUAL_SERVO = """
--servo NAME: model of the servos (default XL330-M288 or STS3215)
--ids LIST = 1: ids of the servos, such as 1,2,3
--udp HOST:PORT: listen there for UDP packets (default: open a pseudo-terminal)
--model MODEL: servos to simulate, in order (MODEL.json)
--kp X = 2.2: proportional gain without --model, N m/rad
--kd X = 0.06: damping without --model, N m s/rad
--latency X = 0.06: latency without --model, s
--inertia X = 0.002: inertia of the load without --model, kg m2
--supply X = 7.4: reported supply voltage, V
--temperature X = 30.0: reported temperature at the start, degrees Celsius
--heating X = 0.0: rate at which it rises, degrees Celsius per second
--loss X = 0.0: share of packets lost in each direction
--noise X = 0.0: share of corrupted bytes
--echo: echo what the host sends, as on a half-duplex wire
--fast: transmit without the delay of the baud rate
"""
_TRACK = """
video FILE: overhead video of the pool
--camera TOML!: camera (camera.toml)
--out CSV!: pool recording to write
--servo CSV: recording of the servos to combine with the poses
--joints JOINT+ = j1: names of the joints, without --servo
--sync HOW = correlate: correlate (yaw with joints), or the video's time in s at the recording's 0
"""
_CALIBRATE_CAMERA = """
pictures PICTURE+: pictures of a ChArUco board, or a video of one
--board LIST = 7,5,0.04,0.03: ChArUco board: squares across, squares down, side of a square in m,
    side of a marker in m
--dictionary {} = 4x4_50: ArUco dictionary of the board
--pool LIST = 3.6,3.6: length and width of the pool in m
--corners U,V*4!: pixels of the four corners of the pool: the origin first, then along x
--out TOML!: camera to write (camera.toml)
"""
_DICTIONARIES = (
    "4x4_50|4x4_100|5x5_50|5x5_100|6x6_50|6x6_250|apriltag_16h5|apriltag_25h9|apriltag_36h11"
)

_BUSES, _CAMERA = "sim2real.commands.buses", "sim2real.commands.camera"

COMMANDS = {
    "record": Command(
        "sim2real.commands.record",
        [_RECORD, _PORT.format(""), _BUS, _DRIVEN],
        "steps --robot robot.toml --port /dev/ttyUSB0 --ids 1,2,3 --out steps.csv",
    ),
    "bench": Command(
        "sim2real.commands.bench",
        [_PORT.format("!"), _BUS, _BENCH, _DRIVEN],
        "--bus feetech --port /dev/ttyUSB0 --ids 1 --mass 0.1 --arm 0.12",
    ),
    "scan": Command(
        f"{_BUSES}:scan",
        [_PORT.format("!"), _BUS, "--ids LIST = 0-253: ids to ask, such as 1,2,10-20"],
        "--port /dev/ttyUSB0",
    ),
    "virtual-servo": Command(
        f"{_BUSES}:virtual_servo", [_BUS, _VIRTUAL_SERVO], "--ids 1,2,3 --loss 0.02 --noise 0.001"
    ),
    "track": Command(
        f"{_CAMERA}:track_video",
        [_TRACK],
        "swim.mp4 --camera camera.toml --servo servos.csv --out swim.csv",
    ),
    "calibrate-camera": Command(
        f"{_CAMERA}:calibrate_camera",
        [_CALIBRATE_CAMERA.format(_DICTIONARIES)],
        "board.mp4 --corners 98,429 516,441 529,22 110,8 --out camera.toml",
    ),
}
