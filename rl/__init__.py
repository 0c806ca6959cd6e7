"""Learning to swim; see the README for what exists so far."""
