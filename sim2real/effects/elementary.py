"""Sine and exponential for the inner loop of a rollout, without a call to the mathematical library.

A library call in each sub-step takes as long as the rest of a linear servo's sub-step: the compiler
must save all registers around it and cannot interleave two rows. These functions are inlined.
Both reduce the argument in two parts (Cody and Waite, Software Manual for the Elementary Functions
(Prentice Hall, 1980)) and then sum the Taylor series to double precision by Estrin's scheme; errors
are a few units in the last place of 1.
"""

import math

import warp as wp

_ROUNDER = wp.constant(wp.float64(6755399441055744.0))
"""1.5 * 2^52: adding and then subtracting it rounds to the nearest integer."""
_HALF_PI = wp.constant(wp.float64(1.57))
_PER_PI = wp.constant(wp.float64(0.3183098861837907))
_PI_HIGH = wp.constant(wp.float64(3.1415926534682512))
"""The first 33 bits of pi, so that its product with an integer below 2^20 is exact."""
_PI_LOW = wp.constant(wp.float64(1.2154201013012384e-10))
_MOST_TURNS = wp.constant(wp.float64(1e5))
_PER_LN2 = wp.constant(wp.float64(1.4426950408889634))
_LN2_HIGH = wp.constant(wp.float64(0.6931471803691238))
_LN2_LOW = wp.constant(wp.float64(1.9082149292705877e-10))
_MOST_DECAY = wp.constant(wp.float64(700.0))
_S = {n: wp.float64((-1.0) ** (n // 2) / math.factorial(n)) for n in range(3, 20, 2)}
"""Coefficients of the sine's Taylor series, by power."""
_E = {n: wp.float64(1.0 / math.factorial(n)) for n in range(2, 13)}
"""Coefficients of the Taylor series of the exponential, by power."""


@wp.func
def sine(x: wp.float64) -> wp.float64:
    """Sine of an angle in rad."""
    r = wp.float64(x)
    sign = wp.float64(1.0)
    if not (wp.abs(x) < _HALF_PI):  # usual angles need no reduction
        turns = (x * _PER_PI + _ROUNDER) - _ROUNDER
        if not (wp.abs(turns) < _MOST_TURNS):  # NaN too
            return wp.sin(x)
        r = (x - turns * _PI_HIGH) - turns * _PI_LOW
        half = wp.float64(0.5) * turns
        odd = half - ((half + _ROUNDER) - _ROUNDER)  # 0 after an even number of half turns
        sign = wp.float64(1.0) - wp.float64(8.0) * odd * odd
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    a = wp.static(_S[3]) + z * wp.static(_S[5])
    b = wp.static(_S[7]) + z * wp.static(_S[9])
    c = wp.static(_S[11]) + z * wp.static(_S[13])
    d = wp.static(_S[15]) + z * wp.static(_S[17])
    d += z2 * wp.static(_S[19])
    series = (a + z2 * b) + z4 * (c + z2 * d)
    return sign * (r + r * z * series)


@wp.func
def decay(x: wp.float64) -> wp.float64:
    """``exp(-x)`` for x of at least 0."""
    if not (x < _MOST_DECAY):
        return wp.exp(-x)
    shifted = _ROUNDER - x * _PER_LN2
    halvings = shifted - _ROUNDER  # 0 or negative
    r = (-x - halvings * _LN2_HIGH) - halvings * _LN2_LOW
    z2 = r * r
    z4 = z2 * z2
    a = wp.float64(1.0) + r
    b = wp.static(_E[2]) + r * wp.static(_E[3])
    c = wp.static(_E[4]) + r * wp.static(_E[5])
    d = wp.static(_E[6]) + r * wp.static(_E[7])
    e = wp.static(_E[8]) + r * wp.static(_E[9])
    f = wp.static(_E[10]) + r * wp.static(_E[11])
    f += z2 * wp.static(_E[12])
    series = (a + z2 * b) + z4 * ((c + z2 * d) + z4 * (e + z2 * f))
    exponent = wp.int64(halvings) + wp.int64(1023)
    return series * wp.cast(exponent << wp.int64(52), wp.float64)
