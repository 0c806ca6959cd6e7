"""What swims in a pool say of a model: calibration, emulator, diagnosis."""
