"""Commands that swim; ``sim2real.cli`` imports them when they run."""
