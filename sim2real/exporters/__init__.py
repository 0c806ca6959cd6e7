"""What was identified, written for other simulators: actuators and randomization ranges."""
