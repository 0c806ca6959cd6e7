"""The reduced-order twin: the same robots in water described by a force law."""
