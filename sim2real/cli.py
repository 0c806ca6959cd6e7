"""The command line: list of commands, dispatch, standard streams, and exit status.

The options of a command are defined in a separate file ``options``, which is imported only for that
command; its code is imported only when it runs, so that help is fast.
"""

import argparse
import contextlib
import importlib
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from sim2real.commands.files import check_files
from sim2real.errors import InputError, missing_library
from sim2real.output import Results, finite_json, is_standard_output, place_of, results

_SERVOS, _WATER = "sim2real.commands.options", "sim.commands.options"
_LEARNING = "rl.commands.options"

COMMANDS = {
    "example": (_SERVOS, "copy example recordings, with their robots, into a folder"),
    "check": (_SERVOS, "check recordings, and state what they can identify"),
    "identify": (_SERVOS, "identify the gains and latency of each servo from recordings"),
    "diagnose": (_WATER, "find physics missing from the fitted model, and model it"),
    "predict": (_SERVOS, "simulate an identified model on the commands of a CSV file"),
    "design": (_WATER, "design the commands to record next, which tell most"),
    "density": (_SERVOS, "compute the normalised density of each link of a robot"),
    "calibrate": (_WATER, "fit body and fluid parameters to recorded swims"),
    "fit-twin": (_WATER, "fit the force law of the twin to a robot in the fluid"),
    "ranges": (_SERVOS, "derive randomization ranges from recordings and sample the posterior"),
    "simulate": (_WATER, "simulate a swim in the lattice-Boltzmann fluid"),
    "train": (
        _LEARNING,
        "train policies with soft actor-critic in the fluid or its reduced-order twin",
    ),
    "evaluate": (_LEARNING, "measure policies and classical controllers on a task"),
    "forecast": (_LEARNING, "predict what policies will do on the real robot, with intervals"),
    "ablate": (_LEARNING, "train with and without each technique, and report the effect of each"),
    "reproduce": (_LEARNING, "make the figures of the paper: curves, stages, turn, pentagram"),
    "export": (_LEARNING, "write a trained policy for NumPy, a microcontroller or ONNX"),
    "swim": (_LEARNING, "drive the robot, or a virtual one, to a target with a policy"),
    "latency": (_SERVOS, "split the latency of a robot by its causes, with a range for each"),
    "import": (_SERVOS, "convert logs of other projects to recordings"),
    "robot": (_SERVOS, "write a robot.toml from a URDF, and list missing fields"),
    "export-servo": (_SERVOS, "export identified actuators to another simulator"),
    "export-ranges": (_SERVOS, "export randomization ranges to another simulator"),
    "bench": (_SERVOS, "scan, record and identify servos on a bench, and write a page"),
    "servos": (_SERVOS, "list identified servos, write the model of one, or prepare a new entry"),
    "record": (_SERVOS, "play a signal on servos and record their positions"),
    "scan": (_SERVOS, "list the servos on a bus with position, voltage, temperature and errors"),
    "virtual-servo": (_SERVOS, "simulate servos on a bus, without hardware"),
    "track": (_SERVOS, "track the pose of the body in an overhead video"),
    "calibrate-camera": (_SERVOS, "calibrate the lens and the pose of the overhead camera"),
    "demo": (_LEARNING, "run the whole chain on the shipped data and write an HTML report"),
    "completion": (_SERVOS, "print a shell completion script"),
}
"""Module of options and summary of each command, in the order of the help."""

_SMALL_MATRICES = (
    "bench", "check", "identify", "design", "diagnose", "latency", "ranges", "calibrate", "demo",
)  # fmt: skip
"""Commands that multiply only small matrices, between rollouts that use all cores: threads of a
linear algebra library would occupy cores in busy waiting."""


def _natural(text: str) -> int:
    """A non-negative whole number."""
    if not text.strip().isdecimal():
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a whole number of at least 0")
    return int(text)


_COMMON = argparse.ArgumentParser(add_help=False)
_COMMON.add_argument(
    "--seed", type=_natural, default=0, help="seed of everything random (default 0)"
)
_COMMON.add_argument(
    "--json", action="store_true", help="print the result as JSON, all else to standard error"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: 0 if done, 2 for wrong input (reported in one line), 1 otherwise."""
    occupy_standard_descriptors()
    out, err = Lenient(sys.stdout), Lenient(sys.stderr)
    typed = list(sys.argv[1:] if arguments is None else arguments)
    name = typed[0] if typed[:1] and typed[0] in COMMANDS else ""
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):  # type: ignore[type-var]
        status = _reported(typed, f"sim2real {name}".strip())
        out.flush()
        if out.error is not None and not isinstance(out.error, BrokenPipeError):
            print(f"sim2real {name}: standard output: {out.error.strerror}", file=err)
    return status if out.error is None else status or 1


def _reported(typed: Sequence[str], program: str) -> int:
    """Run one command; report whatever stops it, in one line."""
    options = argparse.Namespace(resumes=False, files=Results())
    try:
        parser(only=typed[:1]).parse_args(typed, namespace=options)
        return _run(options)
    except InputError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        state = "files written so far are whole" if options.files.written else "nothing written"
        state = "the same call resumes" if options.resumes else state
        print(f"{program}: interrupted; {state}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        if (missing := missing_library(error)) is None:
            raise
        print(f"{program}: {missing}", file=sys.stderr)
        return 2
    except OSError as error:
        about = f"{error.filename}: " if error.filename else ""
        reason = " ".join(str(error.strerror or error).split())
        print(f"{program}: {about}{reason}", file=sys.stderr)
        return 1


def _run(options: argparse.Namespace) -> int:
    """Run the command of these options, with results that replace none of its inputs."""
    if options.command in _SMALL_MATRICES:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is first imported
    module, _, function = options.module.partition(":")
    run = getattr(importlib.import_module(module), function or "run")
    with warnings.catch_warnings(), results() as files, contextlib.ExitStack() as stack:
        said = f"sim2real {options.command}:"
        warnings.showwarning = lambda text, *_, **__: print(said, "warning:", text, file=sys.stderr)
        check_files(options)
        options.files = files
        if is_standard_output(getattr(options, "out", None) or ""):
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        try:
            status: int = run_as_json(run, options) if options.json else run(options)
        finally:
            for sentence in files.kept:
                print(said, sentence, file=sys.stderr)
    return 1 if files.kept else status


def parser(only: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """The parser, with the options of all commands or of these only."""
    root = argparse.ArgumentParser(
        prog="sim2real",
        description="Identify servos, diagnose missing physics, generate randomization ranges.",
        epilog="'sim2real COMMAND --help' shows the options of a command and an example. "
        "Exit status: 0 done, 2 bad input, 1 anything else.",
    )
    version = ""
    if only and only[0] == "--version":  # it is read only then
        from sim2real.version import __version__ as version
    text = f"%(prog)s {version}"
    help_text = "print the version and exit"
    root.add_argument("--version", action="version", version=text, help=help_text)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (home, summary) in COMMANDS.items():
        included = only is None or name in only
        entry = importlib.import_module(home).COMMANDS[name] if included else None
        command = commands.add_parser(
            name,
            parents=[_COMMON],
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            epilog=f"example:\n  sim2real {name} {entry.example}" if entry else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if entry:
            command.set_defaults(module=entry.module, resumes=entry.resumes, result=None)
            entry.add(command)
    return root


class Lenient:
    """A text stream, or None, whose first failure is kept as ``error``; later text is dropped."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream
        self.error = OSError(0, "closed") if stream is None else None

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        with self._caught() as stream:
            if stream is not None:
                try:
                    stream.write(text)
                except UnicodeEncodeError as error:
                    code = error.encoding
                    stream.write(text.encode(code, "backslashreplace").decode(code))
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        with self._caught() as stream:
            if stream is not None:
                stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - any attribute of the stream
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _caught(self) -> Iterator[TextIO | None]:
        """The stream, or None after a failure, which is kept."""
        try:
            yield None if self.error else self._stream
        except (OSError, ValueError) as error:  # of a closed stream, a ValueError
            self.error = error if isinstance(error, OSError) else OSError(0, str(error))
            with contextlib.suppress(OSError, ValueError, AttributeError):
                # What is still in its buffer must not fail again when the program ends.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())  # type: ignore[union-attr]


def occupy_standard_descriptors() -> None:
    """Open the null device for descriptors 0 to 2 that are closed, so that no result gets them."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def run_as_json(run: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Run a command; print its output to standard error, its result (or its file) to output."""
    with contextlib.redirect_stdout(sys.stderr):
        status = run(options)
    result, out = options.result, getattr(options, "out", None)
    if status == 0 and result is None and isinstance(out, Path):
        place = place_of(out)
        result = {"out": str(place)}
        if out.suffix == ".json" and place is not None:
            result = json.loads(place.read_text(encoding="utf-8"))
    if status == 0 or result is not None:  # such as the findings of a refused recording
        print(json.dumps(finite_json(result), allow_nan=False))
    return status


if __name__ == "__main__":
    sys.exit(main())
