"""The actuator as it is simulated: its law, its parameters, and batched rollouts."""
