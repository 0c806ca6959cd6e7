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


class Sheet:
    """A dataclass with a name that is what it states, wherever it was read."""

    name: str

    def _stated(self) -> dict[str, Any]:
        return {n: v for n, v in vars(self).items() if n != "where" and v is not None}

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._stated() == other._stated()

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        stated = ", ".join(f"{n}={v!r}" for n, v in self._stated().items())
        return f"{type(self).__name__}({stated})"
