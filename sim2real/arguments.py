"""Checks of the arguments of Python calls; an invalid one raises an InputError of one line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Integral

from sim2real.errors import InputError
from sim2real.structured import one_of, shown


def check_choice(call: str, argument: str, value: object, choices: Iterable[str]) -> None:
    """Check that ``value`` is one of ``choices``.

    Args:
        call: The function that was called, for the message.
        argument: The argument's name.
        value: Its value.
        choices: Valid values.

    Raises:
        InputError: If it is none of them; the message names the most similar choice.
    """
    names = list(choices)
    if isinstance(value, str) and value in names:
        return
    raise InputError(call, argument, shown(value), one_of(value, names))


def check_whole(call: str, argument: str, value: object, least: int = 0) -> None:
    """Check that ``value``, such as a seed, is a whole number of at least ``least``.

    Raises:
        InputError: If it is not.
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
    if not whole:
        raise InputError(call, argument, shown(value), f"a whole number of at least {least}")


def names_of(call: str, argument: str, value: str | Sequence[str]) -> list[str]:
    """A list of names without duplicates, from a list or a single name.

    Raises:
        InputError: If an entry is not a string.
    """
    listed = [value] if isinstance(value, str) else list(value)
    for entry in listed:
        if not isinstance(entry, str):
            raise InputError(call, argument, shown(entry), "a name or a list of names")
    return list(dict.fromkeys(listed))
