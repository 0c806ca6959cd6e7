"""Sample the posterior of one servo from its recordings, and check it on a held-out one."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import SIGNATURE, named
from sim2real.errors import InputError
from sim2real.identification.priors import (
    MOTOR_SHEET,
    motor_prior,
    of_effects,
    plain_parameters,
    scale_inertia,
)
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import fit
from sim2real.identification.uncertainty import uncertainty
from sim2real.inference.least_squares import rms
from sim2real.inference.normal import LEVEL
from sim2real.inference.parameters import Parameter
from sim2real.model import JointModel
from sim2real.posterior.chain import (
    LEAST_TIMES,
    Chain,
    clear_leftovers,
    new_chain,
    read_chain,
    run_chain,
)
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, FIRST_COLUMN, LINE, joint_row
from sim2real.servo.rollout import rollout_on
from sim2real.servo.trace import Trace
from sim2real.units import unit_of

STEPS, WALKERS = 2000, 32
LEVELS = (0.5, 0.8, 0.95)
"""Probabilities of the bands of a predictive check."""
RANDOM_EFFECTS = ("latency_jitter", "packet_loss")
"""Effects that are random for given parameters; their parameters are not sampled."""
_ORIGIN = ("centre", "factor", "spread", "noise")


@dataclass(frozen=True)
class ServoPosterior:
    """A sample of the posterior of one servo."""

    problem: ServoProblem  # the recordings, and the F sampled parameters with their priors
    values: Array  # the sample, shape (N, F), ordered by step and then by walker
    chain: Chain  # the chain, with all steps
    # parameters of effects that the recordings do not determine, which are held at the model's
    # values
    undetermined: tuple[str, ...] = ()
    level: float = LEVEL  # probability of its intervals

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The F parameters, with their units and priors."""
        return self.problem.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.problem.names

    @property
    def shares(self) -> tuple[float, float, float]:
        """Probabilities of the lower end, the median and the upper end of intervals."""
        return 0.5 - self.level / 2, 0.5, 0.5 + self.level / 2

    def quantiles(self, *shares: float) -> Array:
        """Quantiles of each parameter, shape (len(shares), F)."""
        return np.asarray(np.quantile(self.values, shares, axis=0))


def loaded(trace: Trace, joint: JointModel) -> Trace:
    """The trace with its load, or ``PER_INERTIA`` if the model is per unit of inertia."""
    if joint.per_inertia:
        return replace(trace, load=PER_INERTIA)
    if trace.load is PER_INERTIA:
        return replace(trace, load=joint.load or Load(joint.inertia_kgm2))
    return trace


def servo_problem(
    traces: Sequence[Trace], joint: JointModel, servo: Servo | None = None, held: Sequence[str] = ()
) -> ServoProblem:
    """All parameters that the fit of a model determined, with the bounds and priors of the fit.

    Without the data sheet of its servo, a motor is as in the model, as are parameters that are
    ``held``. Those of effects that are random for given parameters are set to 0: a rollout without
    them has approximately their mean response, and the deviation from it is noise.
    """
    with_loads = [loaded(trace, joint) for trace in traces]
    row = joint_row(joint, with_loads[0].load)
    for name in RANDOM_EFFECTS:
        row[FIRST_COLUMN[name]] = 0.0
    ties, free = None, plain_parameters(with_loads, row)
    if joint.motor and servo is not None and servo.states(*MOTOR_SHEET):
        prior = motor_prior(servo, with_loads)
        if joint.law == "current_limited":
            prior = prior.flat(max(joint.kd_Nms_per_rad, 1e-9))
        motor = {f"motor.{name}" for name in joint.motor}
        motor |= {name for name in joint.interval if name.startswith("motor.")}
        free, ties = prior.of((*BASE[:3], *motor)), prior.ties
    stated = {f"{e.effect}.{name}" for e in joint.effects for name in e.parameters}
    known = {p.name for p in free}
    effects = [named(e.effect) for e in joint.effects if e.effect not in RANDOM_EFFECTS]
    of_all = of_effects(effects, row, scale_inertia(with_loads, row))
    free += tuple(p for p in of_all if p.name in stated - known)
    units = {p.name: unit_of(p.name, per_inertia=joint.per_inertia) for p in free}
    free = tuple(replace(p, unit=units[p.name]) for p in free if p.name not in held)
    return ServoProblem(with_loads, row, free, ties if set(LINE) <= set(units) else None)


def sample_servo(
    traces: Sequence[Trace],
    joint: JointModel,
    servo: Servo | None = None,
    *,
    seed: int = 0,
    steps: int = STEPS,
    walkers: int = WALKERS,
    file: Path | None = None,
    level: float = LEVEL,
    progress: Callable[[int], None] = lambda steps: None,
) -> ServoPosterior:
    """Sample all parameters that the fit of a model determined.

    The likelihood is that of the fit, which counts correlated residuals as fewer samples. Draws are
    spread about the optimum by the ratio of the covariances of the fit (a sandwich) and of this
    likelihood, which makes their intervals those of ``identify`` (curvature adjustment: Ribatet,
    Cooley and Davison, Statistica Sinica 22 (2012) 813-845). Parameters of effects that the
    recordings do not determine are held at the model's values.

    The search for the optimum starts from the model. ``steps`` are the most that each of the
    ``walkers`` takes, including those in ``file``, a chain that is continued if it exists: a chain
    of twice the length that is asked of it ends. ``level`` is the probability of the intervals;
    ``chain.reached`` of the sample tells whether the chain is long enough.

    Raises:
        InputError: If ``file`` is the chain of another problem, or there are too few walkers.
    """
    problem = servo_problem(traces, joint, servo)
    best = fit(problem, problem.row[None])
    undetermined = uncertainty(best, repeating=False).undetermined
    names = (best.names[k] for k in sorted(undetermined))
    held = tuple(name for name in names if "." in name and not name.startswith("motor."))
    if held:
        problem = servo_problem(traces, joint, servo, held)
        best = fit(problem, problem.row[None])
    F = len(problem.parameters)
    if walkers < 2 * F:
        raise InputError("--walkers", "", str(walkers), f"at least {2 * F} for {F} parameters")
    chain = _resumed_or_new(best, seed, walkers, file)
    centre, factor, spread, noise = (chain.origin[name] for name in _ORIGIN)

    def log_posterior(w: Array) -> Array:
        x = _folded(problem, centre + w @ factor.T)
        inside = ((x >= problem.box[0]) & (x <= problem.box[1])).all(axis=1)
        value = np.full(len(x), -np.inf)
        if inside.any():
            error = problem.residuals(x[inside])
            value[inside] = -0.5 * problem.loss(x[inside], error, *noise)
        return np.where(np.isfinite(value), value, -np.inf)

    progress(chain.steps)
    chain = run_chain(chain, log_posterior, steps, file, progress, spans=2 * LEAST_TIMES)
    progress(steps)
    x = _folded(problem, centre + chain.sample() @ spread.T)
    return ServoPosterior(
        problem=problem,
        values=problem.values(np.clip(x, *problem.box)),
        chain=chain,
        undetermined=held,
        level=level,
    )


def _folded(problem: ServoProblem, x: Array) -> Array:
    """Points with those below 0 reflected, of parameters that begin at 0 (B, F)."""
    from_zero = ~problem.log & (problem.box[0] == 0)
    return np.where(from_zero, np.abs(x), x)


def _factors(best: Fit) -> tuple[Array, Array]:
    """Factors of the covariance of the likelihood that is sampled, and of that of the fit.

    A product of the first with its transpose is the covariance; a direction that the recordings
    leave open keeps the width of the prior.
    """
    information = best.information() + np.diag(best.problem.natural**-2.0)
    factor = np.linalg.cholesky(np.linalg.inv(information))
    inverse = np.linalg.inv(factor)
    ratio, directions = np.linalg.eigh(inverse @ uncertainty(best).covariance @ inverse.T)
    ratio = np.where(ratio > 1e-6, ratio, 1.0)
    return factor, factor @ (directions * np.sqrt(ratio)) @ directions.T


def _resumed_or_new(best: Fit, seed: int, walkers: int, file: Path | None) -> Chain:
    """The chain in ``file``, or a new one from the optimum."""
    problem = best.problem
    # everything that the chain depends on, except its length
    stated = f"{SIGNATURE} {problem.parameters} {problem.ties} {seed} {walkers}"
    digest = hashlib.sha256(stated.encode())
    digest.update(problem.row.tobytes())
    for trace in problem.traces:
        digest.update(str(trace.load).encode())
        for values in (trace.t, trace.command, trace.position, trace.used):
            digest.update(np.ascontiguousarray(values).tobytes())
    fingerprint = digest.hexdigest()
    if file is not None:
        clear_leftovers(file)
    if file is not None and file.exists():
        chain = read_chain(file)
        expected = "that of this call; remove the file to start again"
        if chain.fingerprint != fingerprint:
            found = "the chain of other recordings, another model, version or seed"
            raise InputError(file, "", found, expected)
        return chain
    factor, spread = _factors(best)
    noise = np.array([best.scale_rad, best.inflation])
    origin = dict(zip(_ORIGIN, (best.x, factor, spread, noise), strict=True))
    chain = new_chain(walkers, best.x.size, seed, origin, fingerprint)
    x = _folded(problem, best.x + chain.origin["start"] @ factor.T)
    inside = np.linalg.solve(factor, (np.clip(x, *problem.box) - best.x).T).T
    return replace(chain, origin={**chain.origin, "start": np.asarray(inside)})


@dataclass(frozen=True)
class PredictiveCheck:
    """Predictions of a posterior for one recording, and the measured angles."""

    recording: str  # its name
    t: Array  # times in s, shape (T,)
    measured: Array  # angles in rad, shape (T,), NaN where the sample was not held out
    median: Array  # median of the predictions, shape (T,)
    band: Array  # ends of the central 95 % of the predictions, with noise, shape (2, T)
    # share of measured angles within the central band of each of ``LEVELS``
    covered: Mapping[float, float]
    rmse: float  # root mean square error of the median in rad

    @property
    def holds(self) -> bool:
        """Whether the band of 95 % contains at least 85 % of the samples."""
        return self.covered[0.95] >= 0.85


def predictive_check(
    posterior: ServoPosterior,
    joint: JointModel,
    fitted: Sequence[Trace],
    held_out: Trace,
    rng: np.random.Generator,
    draws: int = 200,
) -> PredictiveCheck:
    """Predict a recording with a fit to others and compare it with the measured angles.

    The parameters are ``draws`` from the normal distribution of a fit without the recording; noise
    is added to every prediction, with the root mean square of the residual of that fit. Source:
    Gelman, Meng and Stern, Statistica Sinica 6 (1996) 733-807. ``posterior`` is that of all
    recordings; of ``held_out`` the ``used`` samples are not fitted.
    """
    trace = loaded(held_out, joint)
    without = replace(posterior.problem, traces=[loaded(one, joint) for one in fitted])
    start = without.row.copy()
    start[without.columns] = without.values(posterior.chain.origin["centre"])
    best = fit(without, start[None], rounds=2)
    rows = np.tile(best.row, (draws, 1))
    x = best.x + rng.standard_normal((draws, best.x.size)) @ _factors(best)[1].T
    rows[:, without.columns] = without.values(np.clip(_folded(without, x), *without.box))
    angles = rollout_on(trace, rows)
    noisy = angles + rng.normal(0.0, rms([best.error]) * trace.fit_ratio, angles.shape)
    measured = trace.measured
    present = np.isfinite(measured)
    covered = {}
    for level in LEVELS:
        low, high = np.quantile(noisy, [0.5 - level / 2, 0.5 + level / 2], axis=0)
        covered[level] = float(((measured >= low) & (measured <= high))[present].mean())
    median = np.median(angles, axis=0)
    return PredictiveCheck(
        recording=held_out.name,
        t=trace.t,
        measured=measured,
        median=median,
        band=np.quantile(noisy, [0.025, 0.975], axis=0),
        covered=covered,
        rmse=rms([(median - measured)[present]]),
    )
