"""The actuator: its law, batched rollouts, and the fit of gains and latency."""
