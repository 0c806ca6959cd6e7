"""Real robots: the bus of their servos, how it is reached, and what records from it."""
