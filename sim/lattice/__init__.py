"""The lattice-Boltzmann method in cells: velocity sets, populations, collision, walls."""
