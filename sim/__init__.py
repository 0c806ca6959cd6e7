"""The fluid, swimming robots, their calibration and diagnosis."""
