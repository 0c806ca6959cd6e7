"""The walls along which water slips, without friction, by their names in figures."""

from __future__ import annotations

from sim.fluid.wall import Wall

WALLS = {"forcing": Wall(slip=True), "ghost cells": Wall(slip=True, ghosts=True)}
"""Only the second, the default, is judged: the cases that use this show what forcing lacks."""
