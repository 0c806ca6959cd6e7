"""The library of servos: identified models that ship with the package, and checks of new ones."""
