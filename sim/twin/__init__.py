"""The reduced-order twin: the same robots in water that is a force law."""
