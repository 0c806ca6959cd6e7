"""Export of identified actuators and randomization ranges to other simulators."""
