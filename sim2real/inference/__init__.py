"""One inference for servos and swims alike: it knows neither.

How the pieces go together::

    parameters  ──> what may be fitted: Parameter (name, bounds, unit, nominal, prior), Priors,
                    Gaussian
    noise       ──> samples that count, whitening, autocorrelation times, Wander
    segments    ──> when a residual is larger than noise
    least_squares > minimise(expand, start, low, high): N problems in step; expand gives loss,
                    slope and curvature at points (M, F) of any of them
    evidence    ──> what a minimum is worth: profile likelihood, Laplace, probabilities
    selection   ──> select(problem, ledgers): which candidates a problem needs, every set refitted
    holdout     ──> what a fit does not see

A line through points, with the three lines that any problem needs::

    def expand(x, index):                    # x (M, 2), in units, of the problems index (M,)
        return expansion(y - A @ x[0], -A)   # residuals and their derivatives
    found = minimise(expand, start, low, high)

``sim2real.servo`` makes a problem of a servo's recordings, ``sim.inference`` of a robot's swims.
"""
