"""The command line: what each command takes stands in ``options``.

A command lives in a file of its own that is imported only when it runs, so that help is instant.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from sim2real.errors import InputError
from sim2real.options import exchange, hardware, learning, servos, water

COMMANDS = (
    *servos.COMMANDS,
    *exchange.COMMANDS,
    *water.COMMANDS,
    *learning.COMMANDS,
    *hardware.COMMANDS,
)

_COMMON = argparse.ArgumentParser(add_help=False)
_COMMON.add_argument("--seed", type=int, default=0, help="seed of everything random (default 0)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns:
        0 if it is done, 2 if its input is at fault (said in one line), 1 for anything else.
    """
    options = _parser().parse_args(arguments)
    try:
        status: int = importlib.import_module(options.module).run(options)
        sys.stdout.flush()
        return status
    except InputError as error:
        print(f"sim2real {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        left = "the same call goes on" if options.resumes else "nothing written"
        print(f"sim2real {options.command}: interrupted; {left}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sim2real",
        description="Make a robot's simulator tell the truth.",
        epilog="'sim2real COMMAND --help' shows what a command takes, with an example.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for one in COMMANDS:
        command = commands.add_parser(
            one.name,
            parents=[_COMMON],
            help=one.help,
            description=one.help[0].upper() + one.help[1:] + ".",
            epilog=f"example:\n  {one.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(module=one.module, resumes=one.resumes)
        one.add(command)
    return parser


if __name__ == "__main__":
    sys.exit(main())
