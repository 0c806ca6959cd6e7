"""Expected values of ``--port``."""

EXPECTED = "a serial port, socket://HOST:PORT, rfc2217://HOST:PORT or udp://HOST:PORT"
