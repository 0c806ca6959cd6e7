"""``sim2real servos``."""

import argparse
from pathlib import Path

from sim2real import verbs
from sim2real.commands.files import check_written, save_plot
from sim2real.errors import InputError
from sim2real.model import read_model, write_model
from sim2real.output import check_writable

ADD = "add"
_OF_ADD = ("joint", "as", "type", "source", "licence", "date")


def run(options: argparse.Namespace) -> int:
    """List the servos of the library, write the model of one, or prepare an entry."""
    check_written(options)
    if options.name == ADD:
        return _add(options)
    for option in _OF_ADD:
        if getattr(options, option) is not None:
            raise InputError(f"--{option}", "", options.name or "no servo", "servos add MODEL")
    if options.model is not None:
        raise InputError("servos", "", f"{options.name} {options.model}", "servos add MODEL")
    return _list(options) if options.name is None else _one(options)


def _list(options: argparse.Namespace) -> int:
    for option in ("out", "joints", "firmware_gain", "supply"):
        if getattr(options, option) is not None:
            shown = f"--{option.replace('_', '-')}"
            raise InputError(shown, "", "no servo", "the name of one (sim2real servos lists them)")
    library = verbs.servos()
    options.result = library
    print(library)
    save_plot(library, options.plot)
    return 0


def _one(options: argparse.Namespace) -> int:
    from sim2real.servo_library.catalogue import at

    entry = verbs.servos()[options.name]
    entry = at(entry, firmware_gain=options.firmware_gain, supply_V=options.supply)
    model = entry.for_joints(options.joints or list(entry.model.joints))
    if options.out is not None:
        write_model(model, options.out)
        print(f"{options.out}: {entry.type}, joints {', '.join(model.joints)}")
    else:
        print(entry)
    options.result = entry if options.out is None else None
    save_plot(entry, options.plot)
    return 0


def _add(options: argparse.Namespace) -> int:
    """Check a model, write the entry, and print its row of the table for the review."""
    from sim2real.report.servo_table import markdown_row
    from sim2real.servo_library.catalogue import prepared

    if options.model is None:
        raise InputError("servos add", "MODEL", "nothing", "an identified servo (MODEL.json)")
    given = vars(options)
    about = {name: given[name] for name in ("type", "source", "licence", "date", "firmware_gain")}
    about |= {"name": given["as"], "supply_V": options.supply}
    entry = prepared(read_model(options.model), about, joint=options.joint, file=options.model)
    library = verbs.servos()
    if entry.name in library.names:
        raise InputError("servos add", "--as", entry.name, "a name that is not in the library yet")
    out = check_writable(options.out or Path(f"{entry.name}.json"))
    if out.stem != entry.name:
        raise InputError(out, "", f"the name {out.stem!r}", f"{entry.name}.json, after the entry")
    write_model(entry.model, out)
    print(f"{out}: put it into sim2real/servo_library/entries; its row:")
    print(markdown_row(entry))
    options.result = {"file": str(out), "row": markdown_row(entry)}
    save_plot(entry, options.plot)
    return 0
