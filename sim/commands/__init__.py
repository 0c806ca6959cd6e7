"""Commands that simulate swimming robots; ``sim2real.cli`` imports them when they run."""
