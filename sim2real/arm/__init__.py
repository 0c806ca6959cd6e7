"""Arms: joints that load one another, with the inertias and the geometry of a URDF."""
