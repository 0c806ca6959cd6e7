"""Work in a second process: its results in order, its errors here."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator

import pytest

pytest.importorskip("torch", reason="the extra 'rl' is not installed")

from rl.commands.alongside import Alongside
from sim2real.errors import InputError


def counting(n: int) -> Iterator[tuple[int, int]]:
    for k in range(n):
        yield k, os.getpid()


def failing() -> Iterator[int]:
    yield 1
    raise InputError("swim.csv", "row 3", "nothing", "a number")


def dying() -> Iterator[int]:
    yield 1
    os._exit(7)


def test_results_come_in_order_from_another_process():
    with Alongside(counting, 5) as beside:
        found = list(beside)
    assert [k for k, _ in found] == list(range(5))
    assert {process for _, process in found} != {os.getpid()}


def test_an_error_is_raised_here():
    with Alongside(failing) as beside:
        assert next(beside) == 1
        with pytest.raises(InputError, match=r"swim\.csv: row 3: found nothing, expected a number"):
            next(beside)


def test_a_process_that_dies_is_noticed():
    with Alongside(dying) as beside:
        assert next(beside) == 1
        with pytest.raises(RuntimeError, match="status 7"):
            next(beside)


def test_an_input_error_keeps_its_parts_when_it_is_pickled():
    error = InputError("a.csv", "row 1", "x", "y")
    again = pickle.loads(pickle.dumps(error))
    assert (again.file, again.where, again.found, again.expected) == ("a.csv", "row 1", "x", "y")
    assert str(again) == str(error)
