"""Command-line options for training, evaluating and deploying policies."""

from rl import verbs
from sim2real.commands.command import EXECUTOR, Command

_TASKS = "point|near|mixed|chain|turn|zones|pentagram"
_WATER = """
--robot FILE!: the robot (robot.toml)
--model FILE!: its servos and body (MODEL.json)
--ranges FILE: randomization ranges that episodes are drawn from (ranges.json)
--fidelity twin|fluid = twin: simulate in the reduced-order twin or the fluid
--device TEXT = cpu: device of the simulation, cpu or cuda:0
--cell-m X = 0.02: side of a cell of the fluid, m
--threads N = 1: CPU threads of the simulator
"""
_PLAN = f"""
--task {_TASKS}: task to train on (default chain)
--quick: a small run in the twin, minutes on a CPU; train: on near targets
--recipe default|paper|brief|fine: settings of training: default (a decision every 80 ms), paper
    (the task of the paper), or brief and fine, which continue from trained policies
--first FILE+: policies that training continues from, one per seed in turn
--steps N: simulation steps of 20 ms per agent (default 1600000)
--envs N: parallel environments per agent (default 64)
--segment N: steps between checkpoints (default 200000)
--updates-per-step X: gradient updates per environment step (default 0.1)
--learning-rate X: initial learning rate (default 0.001)
--rate-end X: final learning rate as a share of the initial one (default 0.1)
--batch N: transitions of an update (default 128)
--hidden N+: widths of the hidden layers (default 128 128)
--discount X: discount factor per decision (default 0.99)
--warm-up N: steps of random actions before learning begins (default 10000)
--entropy-start X: initial entropy coefficient (default 0.1)
--entropy-target X*2: target entropy per joint, initial and final (default -1 -2.5)
--noise-s X: correlation time of the exploration noise, s, 0 for white noise (default 0.25)
--no-mirror: learn from no mirror images of transitions
--no-norm: no layer normalization in the critics
--prices X: train for energy weights from 1 / X to X times the default, 1: no others (default 2)
--average X: share of the updates that the saved policy averages, 0: none (default 0.2)
--view default|paper: 20 columns and a decision every 80 ms, or 11 columns and 20 ms
--energy-weight X: weight of squared joint rates in the reward (default 0.0007)
--energy-start X: share of that weight at the start, raised once the agents swim (default 0.1)
"""
_TRAIN = """
--out FOLDER!: folder of the run
--controller sac|discrete-cpg = sac: the policy chooses joint angles (sac) or the gait of a pattern
    generator
--seeds N = 1: number of agents, one per random seed
--trials N = 20: held-out episodes that select each agent's price of energy and the best agent, and
    show whether it learned (exit status 1 if not); 0: none
--no-plots: do not plot the learning curve (curve.png)
--tensorboard: write the progress to OUT/tensorboard while agents learn; needs the extra tensorboard
"""
_ABLATE = """
--reality FILE!: the reality that policies are tested in and never trained in: MODEL.json, or a
    Python file with a function make
--enriched FILE: model with diagnosed effects (MODEL.json), for the arm full-and-effects
--truth FILE: true parameters (MODEL.json), for the arm ceiling (default: --reality, if a model)
--out FOLDER!: folder of the run
--arms full|no-servo|no-density|no-randomization|full-and-effects|ceiling|none+: arms to compare
    (default: the paper's four, the first four; with --enriched also full-and-effects)
--seeds N = 5: random seeds, each one agent, of each arm
--repeats N = 5: episodes that each agent is tested on
--reality-cell-m X: cell of the fluid in the reality, m (default: half of that in training, or as
    the Python file states)
"""
_EVALUATE = f"""
policies POLICY+: policy.zip, policy.zip@0.5 at another price of energy, policy.npz, pnl or adrc,
    also pnl-fast, pnl-frugal and so on
--task {_TASKS} = turn: task
--episodes N = 50: number of episodes
--energy-weight X: weight of the energy in the reward (default 0.0007)
--gains FILE: gains of the controllers pnl and adrc (default: tuned in the twin)
--out FILE: file to write the results to (.json)
--plot FILE: plot of the trajectories to write (.png)
--video FILE: video of each policy's first episode to write (.mp4, .avi or .gif)
"""
_REPRODUCE = """
results learning-curves|stages|calibration|turn|pentagram+: figures of the paper to make
--out FOLDER!: folder for the figures (.png), the film (turn.mp4), their numbers (results.json) and
    a page (index.html)
--run FOLDER = datasets/pool/agents/training: a training (sim2real train --seeds 3): its curves, the
    policies that it kept at stages, and the policy that turns
--policies POLICY+: controllers of the pentagram, as of evaluate, and the policy that turns
    (default: that of --run, pnl, adrc, and the discrete CPG in datasets/pool/agents/discrete-cpg)
--swims SWIM+ = datasets/pool/sine.csv,datasets/pool/square.csv: recorded swims for calibration
--reality FILE = datasets/pool/reality.json: where the turn and the pentagram are real: MODEL.json,
    or a Python file with a function make
--reality-cell-m X: cell of the fluid in the reality, m
--episodes N: swims of each policy (default: 10 at each stage, 3 otherwise)
""" + _WATER.strip().replace("robot FILE!", "robot FILE = datasets/pool/robot.toml").replace(
    "model FILE!", "model FILE = datasets/pool/calibrated.json"
).replace("ranges FILE:", "ranges FILE = datasets/pool/ranges.json:")
_FORECAST = """
--out FILE!: forecast to write (forecast.json)
--no-page: do not write the HTML page
"""
_EXPORT = """
policy FILE: trained policy (POLICY.zip)
--out FILE!: file to write (policy.npz)
--format npz|c|onnx+: NumPy arrays (.npz), a C header (.h) or ONNX (.onnx); by default as FILE ends
--price X: price of energy relative to training: 0.5 swims faster, 2 saves energy (default: as in
    the file)
"""
_SWIM = """
policy FILE: policy (policy.npz or policy.zip)
--target TEXT!: target X,Y in the frame of the pool, m; write negative values as --target=-1,0.5
--port TEXT: radio of the robot: udp://HOST:PORT; with --bus the port of its servos
--bus TEXT: drive servos on a bus of this computer: lx, dynamixel or feetech
--baud N: bits per second, with --bus
--ids TEXT: ids of the servos, with --bus: 1,2,3
--reverse TEXT+: joints whose servo turns in the opposite direction, with --bus
--pose TEXT: address of this computer to which a tracker sends poses, with --bus: udp://HOST:PORT
    (udp://:PORT for a tracker on this computer, udp://0.0.0.0:PORT for any)
--key-file FILE: file with a key that robot and tracker share, of at least 16 characters, which
    authenticates their datagrams (default: environment variable SIM2REAL_KEY; none without)
--max-temperature X = 65.0: stop when a servo is hotter, with --bus, degrees Celsius
--virtual: drive a virtual robot, simulated in the twin
--robot FILE: the robot, with --virtual or --bus (robot.toml)
--model FILE: servos and body of the virtual robot (MODEL.json)
--seconds X = 20.0: longest time to swim, s
--out FILE: recording of the swim to write (.csv)
"""
_DEMO = """
--data FOLDER = datasets/servo_steps: folder of recordings of the servos
--pool FOLDER = datasets/pool: folder of recordings of the pool
--out FOLDER = reports/demo: folder for the report
"""
_FISH = "--robot fish.toml --model model.json"
_POLICIES = "rl.commands.policies"
_JOBS = EXECUTOR.format("all runs in one batch")
COMMANDS = {
    "demo": Command("rl.commands.demo", [_DEMO], "--out reports/demo"),
    "train": Command(
        "rl.commands.train",
        [_WATER, _TRAIN, _PLAN, _JOBS],
        f"--quick {_FISH} --out runs/quick",
        resumes=True,
    ),
    "evaluate": Command(
        f"{_POLICIES}:evaluate", [_WATER, _EVALUATE], f"policy.zip pnl --task turn {_FISH}"
    ),
    "reproduce": Command(
        "rl.commands.reproduce", [_REPRODUCE], "calibration turn --out reproduced"
    ),
    "ablate": Command(
        "rl.commands.ablate",
        [_WATER, _ABLATE, _PLAN, _JOBS],
        f"{_FISH} --ranges ranges.json --reality reality.py --out runs/ablation",
        resumes=True,
        # "all" is what earlier versions called the arm "full"
        types={"arms": lambda arm: arm.replace("all", "full")},
    ),
    "forecast": Command(
        f"{_POLICIES}:forecast",
        [verbs.forecast, _FORECAST],
        f"policy.zip {_FISH} --ranges ranges.json --limit 'time_s<=6@0.95' --out forecast.json",
        resumes=True,
        leave_out=("kept",),
    ),
    "export": Command(
        f"{_POLICIES}:export", [_EXPORT], "policy.zip --out policy.npz --format npz c"
    ),
    "swim": Command(
        "rl.commands.swim",
        [_SWIM],
        "policy.npz --target 1.2,-0.4 --port udp://192.168.4.1:4210 --out swim.csv",
    ),
}
