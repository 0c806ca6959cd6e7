"""Constants of the normal distribution."""

LEVEL = 0.9
"""Probability of intervals unless another one is asked for."""
Z90 = 1.645
"""Half-width of a 90 % interval, in standard deviations; its ends are the quantiles 5 and 95 %."""
NINE_IN_TEN = 1.28
"""90 % quantile, in standard deviations."""
SD_PER_MEDIAN = 1.4826
"""Ratio of the standard deviation to the median absolute deviation."""
