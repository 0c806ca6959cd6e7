"""Every code block of README and docs runs, and every output that they show is what is printed.

A comment before a block says what it is:

- ``<!-- parsed: WHY -->``: it needs hardware, a GPU or minutes, and is only parsed;
- ``<!-- output -->``: what the commands of the block before it print, on the recordings as shipped;
  ``<!-- output: identify -->`` is what that command of them prints. A line ``...`` stands for any
  number of lines, words must be equal, and numbers within ``TOLERANCE``;
- ``<!-- shown -->``: a diagram.

All else runs, a page's blocks one after the other in one folder, which has the shipped recordings,
shortened, in it.
"""

import ast
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from json import loads
from pathlib import Path

import pytest

from sim2real.cli import COMMANDS, main, parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_BLOCK = re.compile(
    r"(?:<!-- (parsed: [^>]+|output(?:: \w+)?|shown) -->\n+)?^```(\w*)[^\n]*\n(.*?)^```",
    re.M | re.S,
)
TOLERANCE = 0.02
"""Relative difference of two numbers that count as equal: last digits depend on the platform."""
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and what the comment before it says.

    Attributes:
        language: As after the fence.
        text: What is in it.
        mark: ``parsed``, ``output``, ``shown`` or nothing.
        command: Of an output the command that prints it, where its block has several.
    """

    language: str
    text: str
    mark: str
    command: str = ""


def blocks(page: Path) -> list[Block]:
    found = _BLOCK.findall(page.read_text(encoding="utf-8"))
    return [
        Block(language, text, kind, name.strip() if kind == "output" else "")
        for mark, language, text in found
        for kind, _, name in [mark.partition(":")]
    ]


def calls(text: str) -> Iterator[list[str]]:
    """The lines of a shell's block as words: continued lines joined, comments gone."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line.removeprefix("$ "), comments=True)
        if words:
            yield words


@pytest.fixture
def folder(short, tmp_path, monkeypatch):
    """What a reader has who stands in a folder of shipped recordings, which are short."""
    monkeypatch.setattr("sim2real.exporters.nearest.SECONDS", 6.0)  # as are those of refits
    return filled(tmp_path, short, monkeypatch)


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """The same, with the recordings as they ship."""
    return filled(tmp_path, ROOT, monkeypatch)


def filled(folder, clone, monkeypatch):
    """A folder with the recordings of a clone, which becomes the current one."""
    for name in ("datasets", "reports", "examples"):
        (folder / name).symlink_to((clone if (clone / name).exists() else ROOT) / name)
    for name in ("steps", "sine", "square", "chirp"):
        for ending in ("csv", "json"):
            shutil.copy(clone / "datasets" / "servo_steps" / f"{name}.{ending}", folder)
    shutil.copy(ROOT / "datasets" / "servo_steps" / "robot.toml", folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "agg")
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_runs(page, folder, capsys):
    space = {"__name__": "page"}
    for block in blocks(page):
        if block.mark in ("shown", "output"):
            continue
        where = f"{page.relative_to(ROOT)}: {block.text[:60]!r}"
        if block.language == "python":
            ast.parse(block.text)
            if not block.mark:
                exec(compile(block.text, str(page), "exec"), space)
        elif block.language == "json":
            loads(block.text)
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language in ("", "sh", "console"):
            for words in calls(block.text):
                run(words, where, parsed=bool(block.mark))
        else:
            assert block.language in ("text", "yaml"), where


OUTPUTS = [
    (page, before, after)
    for page in PAGES
    for before, after in pairwise(blocks(page))
    if after.mark == "output"
]
"""Shown outputs, each with the block of commands before it."""


@pytest.mark.parametrize(
    ("page", "before", "after"),
    OUTPUTS,
    ids=[f"{page.relative_to(ROOT)}-{n}" for n, (page, _, _) in enumerate(OUTPUTS)],
)
def test_a_shown_output_is_what_the_command_prints(page, before, after, shipped, capsys):
    assert before.language in ("", "sh", "console"), "an output follows its commands"
    wanted = [w for w in calls(before.text) if after.command in ("", w[1])]
    assert wanted, f"{page.name}: no command {after.command!r} before its output"
    for words in wanted:
        assert words[0] == "sim2real"
        assert main([name for word in words[1:] for name in expanded(word)]) == 0
    printed = capsys.readouterr().out
    assert agrees(after.text, printed), f"{page.name} shows\n{after.text}\nbut it is\n{printed}"


def test_what_is_shown_and_no_output_is_a_diagram():
    """An output that nothing compares would go out of date unnoticed."""
    for page in PAGES:
        shown = [block for block in blocks(page) if block.mark == "shown"]
        assert all("──>" in block.text for block in shown), page.name


def agrees(shown: str, printed: str) -> bool:
    """Whether a text says what is printed, up to white space and the last digits of numbers."""
    wanted = [line.split() for line in shown.strip().splitlines() if line.strip()]
    lines = [line.split() for line in printed.strip().splitlines() if line.strip()]

    def follow(i: int, j: int) -> bool:
        if i == len(wanted):
            return j == len(lines)
        if wanted[i] == ["..."]:
            return any(follow(i + 1, k) for k in range(j, len(lines) + 1))
        return j < len(lines) and alike(wanted[i], lines[j]) and follow(i + 1, j + 1)

    return follow(0, 0)


def alike(shown: list[str], printed: list[str]) -> bool:
    """Whether two lines have the same words and nearly the same numbers."""
    one, other = " ".join(shown), " ".join(printed)
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    return all(map(near, _NUMBER.findall(one), _NUMBER.findall(other)))


def near(shown: str, printed: str) -> bool:
    """Whether two numbers agree within the tolerance or a unit of the last digit shown."""
    digits = len(shown.partition("e")[0].partition(".")[2])
    a, b = (float(x.replace("−", "-")) for x in (shown, printed))
    return abs(a - b) <= max(
        TOLERANCE * max(abs(a), abs(b)), 1.01 * 10.0**-digits * ("e" not in shown)
    )


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        ("kp  1.38 N m/rad\nRMSE 1.9 mrad\nmore\nend", True),
        ("kp 1.39    N m/rad\nRMSE 1.8 mrad\nend", True),
        ("kp 1.45 N m/rad\nRMSE 1.9 mrad\nend", False),
        ("kp 1.38 N m\nRMSE 1.9 mrad\nend", False),
        ("kp 1.38 N m/rad\nend", False),
        ("kp 1.38 N m/rad\nRMSE 1.9 mrad\nend\nmore", False),
        ("kp -1.38 N m/rad\nRMSE 1.9 mrad\nend", False),
    ],
)
def test_outputs_are_compared_word_by_word(printed, same):
    assert agrees("kp 1.38 N m/rad\nRMSE 1.9 mrad\n...\nend\n", printed) is same


def run(words: list[str], where: str, *, parsed: bool) -> None:
    """One line of a terminal."""
    if words[0] == "make":
        targets = (ROOT / "Makefile").read_text()
        assert f"\n{words[1]}:" in targets, where
    elif words[0] == "sim2real":
        files = [name for word in words[1:] for name in expanded(word)]
        assert files[0] in COMMANDS, where
        parser(only=files[:1]).parse_args(files)
        if not parsed:
            assert main(files) == 0, where
    else:
        assert parsed or words[0] in ("pip", "git", "cd", "python", "pre-commit"), where
        if words[:1] == ["python"] and not parsed:
            assert (ROOT / words[1]).exists(), where


def expanded(word: str) -> list[str]:
    """File names for a pattern, as a shell makes them."""
    return sorted(str(path) for path in Path().glob(word)) if "*" in word else [word]


def test_the_effect_of_the_tutorial_is_one(tmp_path):
    """A copy of the package with that file more lets a servo rest where stop and spring balance."""
    (source,) = [
        b.text for b in blocks(ROOT / "docs/tutorial/your-own-effect.md") if "EFFECT" in b.text
    ]
    shutil.copytree(ROOT / "sim2real", tmp_path / "sim2real")
    (tmp_path / "sim2real" / "effects" / "servo" / "soft_stop.py").write_text(source)
    program = """
import numpy as np
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout
stop = FittedEffect("soft_stop", {"stiffness_Nm_per_rad": 5.0, "angle_rad": 0.2})
row = joint_row(JointModel(2.2, 0.06, 0.05, 0.002, effects=(stop,)), None)
t = 0.02 * np.arange(150)
rest = rollout(row[None], t, np.where(t > 0.2, 0.4, 0.0))[0, -1]
assert abs(rest - (2.2 * 0.4 + 5.0 * 0.2) / 7.2) < 1e-4, rest
"""
    given = os.environ | {"PYTHONPATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=given, check=True, cwd=tmp_path)


def test_links_lead_somewhere():
    """From README and docs to files of the repository."""
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M))
    written = {os.fspath(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert listed == written


def test_search_needs_no_network():
    """Opened from a folder, a browser starts no worker: the site has its own stand-in for one."""
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert re.search(r"^ +- offline$", settings, re.M)
    (script,) = re.findall(r"^ +polyfills: \[(\S+)\]", settings, re.M)
    assert "iframe-worker" in script  # or the plugin would load one from the network
    assert (ROOT / "docs" / script).is_file()


def test_links_of_the_catalogue_become_paths_of_the_repository():
    """The catalogue is written beside the code; the documentation has none of those files."""
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    pytest.importorskip("latex2mathml")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    folder = ROOT / "sim2real" / "effects"
    page = hooks.on_page_markdown("{{effects}}")
    assert "`sim2real/servo/motor.py`" in page and not re.search(r"\]\((?!\w+:|#)", page)
    assert hooks.name_files("[a](https://a.b/c) [d](#d)", folder) == "[a](https://a.b/c) [d](#d)"
    with pytest.raises(FileNotFoundError):
        hooks.name_files("[gone](../servo/gone.py)", folder)
