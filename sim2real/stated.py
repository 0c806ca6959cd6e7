"""Fields that a file may leave out until something uses them."""

from __future__ import annotations

from typing import Any, Generic, Self, TypeVar, overload

from sim2real.errors import InputError

T = TypeVar("T")


class Stated(Generic[T]):
    """A value of a dataclass that may be missing; using it where it is says so in one line.

    The dataclass has a field ``where``, the file and the table that the value would stand in.

    Args:
        expected: What should be there, for the message.
    """

    def __init__(self, expected: str = "a number above 0") -> None:
        self.expected = expected

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type) -> T: ...
    def __get__(self, instance: object | None, owner: type) -> Self | T:
        if instance is None:
            return self
        value: T | None = vars(instance)[self.name]
        if value is None:
            file, table = vars(instance)["where"]
            raise InputError(file, f"{table}.{self.name}", "nothing", self.expected)
        return value

    def __set__(self, instance: object, value: Any) -> None:  # noqa: ANN401 - the default is self
        vars(instance)[self.name] = None if value is self else value


def alike(one: object, other: object) -> bool:
    """Whether two values of one dataclass state the same, wherever they were read."""
    mine, yours = (
        {name: value for name, value in vars(x).items() if name != "where"} for x in (one, other)
    )
    return type(one) is type(other) and mine == yours


def shown(one: object) -> str:
    """What a value of a dataclass states, without what it leaves out."""
    fields = {n: v for n, v in vars(one).items() if n != "where" and v is not None}
    return f"{type(one).__name__}({', '.join(f'{n}={v!r}' for n, v in fields.items())})"
