"""Hardware: the servo bus, its transports, recording, and tracking of the body by camera."""
