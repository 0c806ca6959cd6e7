"""Design of experiments: the commands to record next, so that they tell the most."""
