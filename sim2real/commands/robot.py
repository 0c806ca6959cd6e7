"""``sim2real robot``."""

from __future__ import annotations

import argparse
import sys
import tomllib

from sim2real.errors import InputError
from sim2real.importers.robots import robot_toml
from sim2real.importers.urdf import read_urdf
from sim2real.output import check_writable, write_whole


def run(options: argparse.Namespace) -> int:
    """Write a robot file; print the fields to be filled in, which the file lists too."""
    out = check_writable(options.out)
    text, notes = robot_toml(read_urdf(options.source), options.joints)
    head = f"# From {' '.join(options.source.name.splitlines())}."
    lines = [" ".join(note.splitlines()) for note in notes]
    text = "\n".join([head, *(f"# not here: {line}" for line in lines), text])
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        expected = "names without control characters"
        raise InputError(
            options.source, "", f"names that TOML can't hold ({error})", expected
        ) from None
    write_whole(out, text)
    options.result = {"file": str(out), "not_in_it": lines}
    print(out)
    if lines:
        print("not in it, to be filled in where a command asks for it:")
        sys.stdout.writelines(f"  {line}\n" for line in lines)
    return 0
