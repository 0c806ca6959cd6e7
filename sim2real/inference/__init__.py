"""Inference for servos and swims, independent of both.

Modules::

    parameters        Parameter (name, bounds, unit, nominal value, prior), Gaussian, kronecker
                      (points that fill a cube evenly)
    correlated_noise  usable samples, whitening, autocorrelation times, slow drift (Wander)
    segments          intervals in which a residual exceeds the noise
    least_squares     minimise(expand, start, low, high): N problems at once; expand returns loss,
                      gradient and curvature at points (M, F) of any of them; cannot_win stops
                      searches that cannot reach the best minimum
    evidence          profile likelihood, Laplace approximation, probabilities of models
    selection         select(problem, ledgers): the candidates that a problem needs, refitting
                      every set

Example, a straight line through points::

    def expand(x, index):                    # x (M, 2), scaled, of the problems index (M,)
        return expansion(y - A @ x[0], -A)   # residuals and their derivatives
    fit = minimise(expand, start, low, high)

``sim2real.identification.servo_problem`` is the problem of a servo's recordings, ``sim.inference``
that of swims.
"""
