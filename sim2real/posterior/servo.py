"""Sample the posterior of one servo from its recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import SIGNATURE, named
from sim2real.effects.effect import scaled
from sim2real.errors import InputError
from sim2real.identification.first_guess import DAMPING_RATIO, FREQUENCY_RAD_S, LATENCY_S
from sim2real.inference.parameters import Parameter, Priors
from sim2real.model import JointModel
from sim2real.posterior.chain import (
    Chain,
    Convergence,
    clear_leftovers,
    convergence,
    new_chain,
    read_chain,
    run_chain,
    sample,
)
from sim2real.posterior.laplace import Laplace, laplace, sharpened
from sim2real.posterior.likelihood import RANDOM_EFFECTS, Likelihood, ServoData, loaded, servo_data
from sim2real.servo.trace import Trace
from sim2real.units import unit_of

STEPS, WALKERS = 2000, 32


@dataclass(frozen=True)
class ServoPosterior:
    """A sample of the posterior of one servo.

    Attributes:
        priors: Priors of the F parameters, with their names and units.
        values: The sample, shape (N, F), ordered by step and then by walker.
        convergence: How well the chain has mixed.
        optimum: Values at the optimum, shape (F,).
        noise_sd: Standard deviation of the innovations at the optimum in rad.
        autoregression: Coefficients of the noise, shape (p,).
        data: The recordings and the fixed parameters.
        exact: Whether the servo was solved in closed form, without sub-steps.
        chain: The chain, with all steps.
        undetermined: Parameters of effects that the recordings do not determine, which are held at
            the model's values.
    """

    priors: Priors
    values: Array
    convergence: Convergence
    optimum: Array
    noise_sd: float
    autoregression: Array
    data: ServoData
    exact: bool
    chain: Chain
    undetermined: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.priors.names

    def quantiles(self, *shares: float) -> Array:
        """Quantiles of each parameter, shape (len(shares), F)."""
        return np.asarray(np.quantile(self.values, shares, axis=0))


def servo_priors(joint: JointModel) -> Priors:
    """Wide priors of a servo's gains, latency and the effects that its model holds.

    Gains are log-uniform over natural frequencies of 2 to 300 rad/s and damping ratios of 0.05 to
    4, latency is uniform up to 0.3 s, and parameters of effects are uniform within the bounds of
    the catalogue, scaled to this servo. Parameters that the model does not state are fixed.
    """
    inertia = joint.inertia_kgm2
    (slow, fast), (low, high) = FREQUENCY_RAD_S, DAMPING_RATIO

    def gain(name: str, low: float, high: float, typical: float) -> Parameter:
        unit = unit_of(name, per_inertia=joint.per_inertia)
        return Parameter(name, low * inertia, high * inertia, typical, log=True, unit=unit)

    kp, kd = joint.kp_Nm_per_rad, max(joint.kd_Nms_per_rad, 1e-9)
    parameters = [
        gain("kp_Nm_per_rad", slow**2, fast**2, kp),
        gain("kd_Nms_per_rad", 2 * low * slow, 2 * high * fast, kd),
        Parameter("latency_s", *LATENCY_S, 0.05),
    ]
    for fitted in joint.effects:
        if fitted.effect in RANDOM_EFFECTS:
            continue
        for parameter in named(fitted.effect).parameters:
            if parameter.name in fitted.parameters:
                p = scaled(parameter, joint.kp_Nm_per_rad, inertia)
                name = f"{fitted.effect}.{p.name}"
                parameters.append(Parameter(name, p.low, p.high, p.typical))
    return Priors(tuple(parameters))


def sample_servo(
    traces: Sequence[Trace],
    joint: JointModel,
    *,
    seed: int = 0,
    steps: int = STEPS,
    walkers: int = WALKERS,
    priors: Priors | None = None,
    file: Path | None = None,
    progress: Callable[[int], None] = lambda steps: None,
) -> ServoPosterior:
    """Sample gains, latency and the parameters of the effects that the model holds.

    Args:
        traces: Recordings of the joint.
        joint: Its model, from which the search for the optimum starts.
        seed: Seed of the chain.
        steps: Total steps of each walker, including those in ``file``.
        walkers: Number of walkers, at least twice the number of parameters.
        priors: Priors; by default ``servo_priors`` of the parameters that are not `undetermined`.
        file: File of the chain, which is continued if it exists; None keeps it in memory.
        progress: Called with the number of completed steps.

    Returns:
        The sample; ``convergence.reached`` is true if the chain is long enough.

    Raises:
        InputError: If ``file`` is the chain of another problem, or there are too few walkers.
    """
    with_loads = [loaded(trace, joint) for trace in traces]
    held: tuple[str, ...] = ()
    if priors is None:
        priors = servo_priors(joint)
        held = undetermined(servo_data(with_loads, joint, priors))
        priors = Priors(tuple(prior for prior in priors.each if prior.name not in held))
    data = servo_data(with_loads, joint, priors)
    F = len(data.priors.each)
    if walkers < 2 * F:
        raise InputError("--walkers", "", str(walkers), f"at least {2 * F} for {F} parameters")
    chain = _resumed_or_new(data, seed, walkers, file)
    origin = chain.origin
    start = Laplace(
        origin["centre"], origin["factor"], origin["autoregression"], float(origin["noise_sd"])
    )
    likelihood = Likelihood(data, start.autoregression)
    progress(chain.steps)
    chain = run_chain(
        chain, lambda w: likelihood.log_posterior(start.coordinates(w)), steps, file, progress
    )
    mixing = convergence(chain)
    return ServoPosterior(
        priors=data.priors,
        values=data.priors.values(start.coordinates(sample(chain, mixing))),
        convergence=mixing,
        optimum=data.priors.values(start.centre),
        noise_sd=start.noise_sd,
        autoregression=start.autoregression,
        data=data,
        exact=likelihood.exact,
        chain=chain,
        undetermined=held,
    )


def undetermined(
    data: ServoData, *, points: int = 21, worse: float = 1.35, most: float = 0.5
) -> tuple[str, ...]:
    """Parameters of effects that hardly change the fit over most of their prior range.

    Each is varied alone, with the others at the model's values; noise is taken to be white, which
    overstates what the recordings tell.

    Args:
        data: The joint, with the priors of all parameters.
        points: Number of equal shares of each prior range, at whose centres the fit is compared.
        worse: Largest decrease of the log-likelihood that is compatible with the recordings: that
            of a 90 % interval.
        most: Compatible share of the range from which the parameter is undetermined.
    """
    varied = [k for k, prior in enumerate(data.priors.each) if "." in prior.name]
    if not varied:
        return ()
    share = (np.arange(points) + 0.5) / points
    anywhere = data.priors.values(np.log(share / (1 - share))[:, None])
    values = np.tile(data.row[data.columns], (len(varied), points + 1, 1))
    for n, k in enumerate(varied):
        values[n, 1:, k] = anywhere[:, k]
    level = Likelihood(data, np.zeros(0))(values.reshape(-1, values.shape[2]))
    level = level.reshape(len(varied), points + 1)
    compatible = (level[:, 1:] > level[:, :1] - worse).mean(axis=1)
    return tuple(data.priors.names[k] for k, s in zip(varied, compatible, strict=True) if s >= most)


def _resumed_or_new(data: ServoData, seed: int, walkers: int, file: Path | None) -> Chain:
    """The chain in ``file``, or a new one from the optimum."""
    fingerprint = _fingerprint(data, seed, walkers)
    if file is not None:
        clear_leftovers(file)
    if file is not None and file.exists():
        chain = read_chain(file)
        if chain.fingerprint != fingerprint:
            found = "the chain of other recordings, another model or seed"
            raise InputError(file, "", found, "that of this call; remove the file to start again")
        for field in dataclass_fields(Laplace):
            if field.name not in chain.origin:
                expected = "it, in a chain; remove the file to start again"
                raise InputError(file, f"origin.{field.name}", "nothing", expected)
        return chain
    start = laplace(data)
    start = sharpened(start, Likelihood(data, start.autoregression).log_posterior)
    origin = {name: np.asarray(value) for name, value in vars(start).items()}
    return new_chain(walkers, len(data.priors.each), seed, origin, fingerprint)


def _fingerprint(data: ServoData, seed: int, walkers: int) -> str:
    """SHA-256 of everything that the chain depends on, except its length."""
    digest = hashlib.sha256(f"{SIGNATURE} {data.priors.each} {seed} {walkers}".encode())
    digest.update(data.row.tobytes())
    for trace in data.traces:
        digest.update(str(trace.load).encode())
        for values in (trace.t, trace.command, trace.position, trace.used):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
