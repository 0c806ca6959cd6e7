"""Inference for servos and swims, independent of both: fits, noise, evidence, model selection."""
