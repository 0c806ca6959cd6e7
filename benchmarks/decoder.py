"""How fast the decoder goes through noise, and that nothing in it makes it fail.

python benchmarks/decoder.py [--bytes 10000000]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from sim2real.hardware.lx import Decoder

CHUNK = 4096


def main() -> None:
    """Feed random bytes, plain and full of false headers, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bytes", type=int, default=10_000_000)
    count = parser.parse_args().bytes
    print(f"{'random bytes':<28}{'packets':>9}{'garbled':>10}{'seconds':>9}{'MB/s':>7}")
    for label, headers in (("as they come", 0.0), ("a fifth of them 0x55", 0.2)):
        rng = np.random.default_rng(0)
        noise = rng.integers(0, 256, count, dtype=np.uint8)
        noise[rng.random(count) < headers] = 0x55
        data = noise.tobytes()
        decoder, packets = Decoder(), 0
        begin = time.perf_counter()
        for start in range(0, count, CHUNK):
            packets += len(decoder.feed(data[start : start + CHUNK]))
        took = time.perf_counter() - begin
        print(f"{label:<28}{packets:>9}{decoder.garbled:>10}{took:>9.2f}{count / took / 1e6:>7.1f}")
    print("no exception")


if __name__ == "__main__":
    main()
