"""Command-line options of commands on recordings, models and servos."""

from sim2real import exchange, verbs
from sim2real.commands.command import VIEWS, Command

_RUNS, _FORMATS = "sim2real.commands.recordings", "sim2real.commands.formats"
_CAMERA = "sim2real.commands.camera"
_BUSES, _RECORDS = "sim2real.commands.buses", "sim2real.commands.record"


_IDENTIFY = """
--out MODEL!: model to write (MODEL.json)
--no-plots: do not plot the fits (MODEL.JOINT.png)
"""
_RANGES = """
--out FILE!: ranges to write (ranges.json)
--no-page: do not write the HTML report
"""
_LATENCY = """
--out FILE: ranges to write (latency.json)
--plot PNG: plot of the causes to write
"""
_PREDICT = """
model MODEL: model (MODEL.json)
commands CSV: commands: a CSV with t_s and J.command_rad
--out CSV!: prediction to write (predicted.csv)
"""
_EXPORT_SERVO = """
model MODEL: identified servos (MODEL.json)
--to mujoco|mjlab|isaaclab|isaaclab-bam|newton|usd|genesis|urdf|casadi|json!: simulator or
    format to write for
--out FILE!: file to write
"""
_EXPORT_RANGES = """
ranges FILE: randomization ranges (ranges.json)
--to isaaclab|mjlab|newton|mujoco-playground!: simulator to write for
--out FILE!: Python file to write
"""
_ROBOT = """
action from-urdf: format to read
source FILE: description of the robot (URDF)
--out TOML!: robot to write (robot.toml)
--joints JOINT+: joints to take, in order (default: all)
"""
_SERVOS = """
name NAME?: servo to show or to write; 'add' to prepare an entry
model MODEL?: add: identified servo (MODEL.json)
--out MODEL: model to write (add: entry, NAME.json)
--joints JOINT+: joints that have this servo (default j1)
--firmware-gain X: write the model for this gain of the firmware; add: that of the recordings
--supply X: write the model for this supply voltage, V; add: that of the recordings
--plot PNG: plot of stall torque and no-load speed to write
--joint JOINT: add: joint of a model that has several
--as NAME: add: name of the entry
--type TEXT: add: make and type of the servo
--source TEXT: add: where the recordings come from
--licence TEXT: add: licence of the recordings
--date DAY: add: day of the recordings (2026-01-31)
"""
_DENSITY = """
robot TOML: the robot, with masses and lengths of its links (robot.toml)
--model MODEL: model to add the densities to (MODEL.json)
--out MODEL: model to write (MODEL.json)
--plot PNG: plot of the mass distribution to write
"""
_IMPORT = """
--out CSV!: recording to write (of parameters: model)
--command-topic TOPIC&: bag: commanded positions; once, or once for each joint
"""
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


COMMANDS = {
    "example": Command(
        f"{_RUNS}:example", ["--out FOLDER = example: folder to write"], "--out example"
    ),
    "check": Command(f"{_RUNS}:check", [verbs.check], "steps.csv sine.csv --robot robot.toml"),
    "identify": Command(
        f"{_RUNS}:identify",
        [verbs.identify, _IDENTIFY, VIEWS],
        "steps.csv sine.csv square.csv --robot robot.toml --out model.json",
    ),
    "density": Command(
        f"{_RUNS}:density",
        [_DENSITY, verbs.density],
        "robot.toml --model model.json --out weighed.json",
    ),
    "predict": Command(
        f"{_RUNS}:predict", [_PREDICT, VIEWS], "model.json chirp.csv --out predicted.csv"
    ),
    "latency": Command(
        f"{_RUNS}:latency", [verbs.latency, _LATENCY], "steps.csv square.csv --out latency.json"
    ),
    "completion": Command(
        f"{_RUNS}:completion",
        ["shell bash|zsh|tcsh: shell to write the script for"],
        "bash > ~/.local/share/bash-completion/completions/sim2real",
    ),
    "import": Command(
        f"{_FORMATS}:import_log",
        [_IMPORT, exchange.import_log],
        "run.bag --state-topic /joint_states --command-topic /goal --out run.csv",
    ),
    "robot": Command(f"{_FORMATS}:robot", [_ROBOT], "from-urdf arm.urdf --out robot.toml"),
    "export-servo": Command(
        f"{_FORMATS}:export_servo",
        [_EXPORT_SERVO, exchange.export],
        "diagnosis.enriched.json --to mujoco --out servos.xml --recordings steps.csv chirp.csv",
        leave_out=("source",),
    ),
    "export-ranges": Command(
        f"{_FORMATS}:export_ranges",
        [_EXPORT_RANGES],
        "ranges.json --to isaaclab --out randomization.py",
    ),
    "servos": Command(
        "sim2real.commands.servos", [_SERVOS], "xl330_gain800 --joints pan tilt --out model.json"
    ),
    "ranges": Command(
        f"{_RUNS}:ranges",
        [verbs.ranges, _RANGES],
        "steps.csv square.csv --robot robot.toml --model model.json --out ranges.json",
        resumes=True,
        leave_out=("chains",),
    ),
    "record": Command(
        f"{_RECORDS}:record",
        [_RECORD, _PORT.format(""), _BUS, _DRIVEN],
        "steps --robot robot.toml --port /dev/ttyUSB0 --ids 1,2,3 --out steps.csv",
    ),
    "bench": Command(
        "sim2real.commands.bench:bench",
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
