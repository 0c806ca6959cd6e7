"""Mutations of a file: of its bytes, lines, numbers, tree, columns, or of what an archive holds."""

import io
import json
import math
import random
import re
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

NUMBERS = [1e300, -1e300, 1e-300, 1e9, -1e9, 1e5, 1e3, 1e-3, 1e-6, 1e-12, 0.0, -1.0, math.inf]
NUMBERS += [-math.inf, math.nan, True, 1, 2, 3, 7, 100, 2**31, 2**63, 10**400]
TEXTS = ["", "nan", "0x1", "9" * 400, "é\u202e", "a/b", "../../a", "\x00", "\n", "j1", "fluid", "-"]
DEEP: Any = 1
for _ in range(300):
    DEEP = [DEEP]
TREES: list[Any] = [None, [], {}, [1, 2], {"a": 1}, [[0.0] * 3] * 4, [0.5] * 20_000, DEEP, True]
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")


def mutate(path: Path, rng: random.Random) -> str:
    """Change a file once or twice; return the names of the mutations."""
    names = []
    for _ in range(1 if rng.random() < 0.7 else 2):
        kinds = [_bytes, _number] if path.suffix in (".npz", ".zip") else [_lines, _number, _bytes]
        special = {".json": _json, ".toml": _toml, ".csv": _columns, ".npz": _archive}
        kinds += [special.get(path.suffix, _archive if path.suffix == ".zip" else _lines)] * 6
        change = rng.choice(kinds)
        before = path.read_bytes()
        try:
            path.write_bytes(change(before, rng))
        except Exception:  # the first mutation left nothing that the second understands
            path.write_bytes(before)
        names.append(change.__name__)
    return ", ".join(names)


def _bytes(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return rng.choice(
        [
            lambda: data[:a],
            lambda: data[:a] + rng.randbytes(rng.choice([1, 9])) + data[a + 1 :],
            lambda: data[:a] + data[b:],
            lambda: data[:b] + data[a:],
            lambda: data + rng.randbytes(30),
            lambda: b"\xef\xbb\xbf" + data,
            lambda: data.replace(b"\n", rng.choice([b"\r\n", b"\r", b"", b"\n\n", b"\x85"])),
            lambda: data.decode("latin1").encode(rng.choice(["utf-16", "utf-32", "utf-7"])),
            lambda: data.replace(b",", rng.choice([b";", b"\t", b" ", b",,"])),
            lambda: b"",
        ]
    )()


def _lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    a, b = sorted(rng.randrange(len(lines)) for _ in range(2))
    few = min(b, a + rng.choice([1, 1, 5, 100]))
    lines[a:few] = rng.choice(
        [[], lines[a:few] * 2, lines[a:few][::-1], [b"# comment\n"], [b"\n"], lines[a:few] * 500]
    )
    return b"".join(lines)


def _number(data: bytes, rng: random.Random) -> bytes:
    found = list(NUMBER.finditer(data))
    one, name = rng.choice(found), rng.choice([*NUMBERS, *TEXTS])
    text = str(name) if rng.random() < 0.9 else json.dumps(name)
    return data[: one.start()] + text.encode() + data[one.end() :]


def _json(data: bytes, rng: random.Random) -> bytes:
    return json.dumps(_tree(json.loads(data), rng)).encode()


def _toml(data: bytes, rng: random.Random) -> bytes:
    tree = _tree(tomllib.loads(data.decode()), rng)
    return "".join(f"{json.dumps(k)} = {_inline(v)}\n" for k, v in tree.items()).encode()


def _inline(value: object) -> str:
    """A value as TOML in one line; null, which TOML lacks, as a text."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps("null" if value is None else value)


def _tree(tree: Any, rng: random.Random) -> Any:
    """The tree with one change in one of its tables or lists."""
    places = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(tree)
    node, key = rng.choice(places)
    value = node[key]
    numeric = [(n, k) for n, k in places if isinstance(n[k], int | float)]
    if numeric and rng.random() < 0.6:
        node, key = rng.choice(numeric)
    value = node[key]
    action = rng.choice(["number", "scale"] * 4 + ["text", "tree", "delete", "rename", "repeat"])
    if action == "number":
        node[key] = rng.choice(NUMBERS)
    elif action == "text":
        node[key] = rng.choice(TEXTS)
    elif action == "tree":
        node[key] = rng.choice([*TREES, rng.choice(places)[0]])
    elif action == "scale" and isinstance(value, int | float):
        node[key] = value * rng.choice([-1, 1e-6, 1e-3, 0.1, 0.9, 1.1, 10, 100, 1e3, 1e6])
    elif action == "delete" or isinstance(node, list):
        node[key : key + 1] = [value] * rng.choice([0, 0, 2, 50]) if isinstance(node, list) else []
    elif action == "rename":
        node[rng.choice([*TEXTS, key + "s", key[:-1], key.upper()])] = node.pop(key)
    else:
        node |= {f"{key}{k}": value for k in range(rng.choice([1, 40]))}
    return tree


def _columns(data: bytes, rng: random.Random) -> bytes:
    table = pd.read_csv(io.BytesIO(data))
    name, other = rng.sample(list(table.columns), 2)
    x, rows = table[name].to_numpy(float), np.arange(len(table))
    a, b = sorted(rng.randrange(len(table) + 1) for _ in range(2))
    inside = (rows >= a) & (rows < b)
    changes = ["scale", "shift", "cells", "stuck", "rows", "swap", "lag", "part", "more", "pause"]
    change = rng.choice(changes)
    scale = rng.choice([0, -1, 1e-9, 1e-3, 0.2, 3, 57.2958, 1e3, 1e6, 1e9, 1e100])
    if change in ("scale", "part"):
        table[name] = np.where(inside | (change == "scale"), x * scale, x)
    elif change == "shift":
        by = rng.choice([2 * np.pi, -np.pi, 1e-4, 0.5, 1e2, 1e6, 1e300])
        table[name] = np.where(inside, x + by, x)
    elif change == "cells":
        table[name] = np.where(inside, rng.choice([np.nan, np.inf, 0.0, 1e308, x[0]]), x)
    elif change == "stuck":
        table[name] = x[np.minimum(rows, a)]
    elif change == "rows":
        order = rng.choice([rows[a:b], rows[:: rng.choice([-1, 2, 30])], np.repeat(rows, 2)])
        table = table.iloc[order if len(order) else rows[:1]]
    elif change == "swap":
        table[[name, other]] = table[[other, name]].to_numpy()
    elif change == "pause":
        table["t_s"] = table["t_s"] + np.where(rows >= a, rng.choice([1, 60, 1e3, 1e6, 1e9]), 0)
    elif change == "lag":
        table[name] = np.roll(x, rng.choice([-3, 3, 30]))
    else:
        table[f"{name}{rng.choice(['', '.1', '_'])}"] = x[::-1]
        table = table.rename(columns={other: rng.choice([name, other.upper(), "t", *TEXTS])})
    return table.to_csv(index=False).encode()


def _archive(data: bytes, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name, other = (rng.choice(list(members)) for _ in range(2))
    action = rng.choice(["content"] * 8 + ["swap", "delete", "add", "bytes", "deflate"])
    if action == "content" and name == "data":
        members[name] = _json(members[name], rng)
    elif action == "content" and name.endswith(".npy"):
        members[name] = _array(members[name], rng)
    elif action == "content" and name.endswith(".pth"):
        members[name] = _tensors(members[name], rng)
    elif action == "swap":
        members[name], members[other] = members[other], members[name]
    elif action == "delete":
        del members[name]
    elif action == "add":
        members[rng.choice(["../a", "a.npy", "data", name.upper()])] = members[other]
    else:
        members[name] = _bytes(members[name], rng)
    out = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if action == "deflate" else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", kind) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return out.getvalue()


def _array(data: bytes, rng: random.Random) -> bytes:
    array: Any = np.load(io.BytesIO(data))
    if array.dtype.kind == "U" and array.ndim == 0 and rng.random() < 0.8:  # settings as JSON
        array = np.array(json.dumps(_tree(json.loads(str(array)), rng)))
    else:
        array = _values(array, rng)
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def _values(array: Any, rng: random.Random) -> Any:
    """An array of other values, another shape or another type."""
    numbers = array if array.dtype.kind in "fiub" else np.zeros(3)
    scaled = numbers * rng.choice([0.0, -1.0, 1e-9, 10.0, 1e6, 1e30])
    one = numbers.astype(float).ravel()
    one[: rng.randrange(one.size + 1)] = rng.choice(NUMBERS[:15])
    one = one.reshape(numbers.shape)
    kinds = [array[..., None], array.ravel(), array[:0] if array.ndim else array[None], scaled, one]
    kinds += [np.repeat(np.atleast_1d(array), 2, axis=0), array.T, np.array(7.0), np.array("x")]
    kinds += [numbers.astype(rng.choice(["f2", "f8", "i1", "c16", "U3", "?", ">f4"]))]
    kinds += [np.full(np.shape(array), None), np.zeros((0, 5)), np.zeros(3)]
    return rng.choice(kinds)


def _tensors(data: bytes, rng: random.Random) -> bytes:
    import torch

    tensors = torch.load(io.BytesIO(data), weights_only=True)
    name = rng.choice(list(tensors))
    value = _values(tensors[name].numpy(), rng)
    tensors[name] = torch.from_numpy(np.array(value)) if value.dtype.kind in "fiub" else str(value)
    if rng.random() < 0.2:
        tensors[rng.choice(["a", name.upper()])] = tensors.pop(name)
    out = io.BytesIO()
    torch.save(tensors, out)
    return out.getvalue()
