"""What MkDocs runs while it builds.

Equations become MathML, which needs no script to be shown; options of commands stay in one piece.
Two pages are written from the code: the command line and the catalogue of effects.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

ROOT = Path(__file__).resolve().parents[1]
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
_SHELL = re.compile(r'<div class="language-sh.*?</div>', re.DOTALL)
_OPTION = re.compile(r"(?<=</span>)--[a-z][\w-]*")
_FILE_LINK = re.compile(r"\[[^\]]*\]\((?!\w+:|#)([^)#\s]+)[^)]*\)")


def on_page_content(content: str, **_: Any) -> str:  # noqa: ANN401 - MkDocs'
    """Equations as MathML; a command wraps between its options, not inside one."""
    whole = '<span class="option">\\g<0></span>'
    content = _SHELL.sub(lambda block: _OPTION.sub(whole, block[0]), content)
    return _EQUATION.sub(_mathml, content)


def _mathml(found: re.Match[str]) -> str:
    display = "block" if found[2] == "[" else "inline"
    return str(convert(html.unescape(found[3]), display=display))


def on_page_markdown(markdown: str, **_: Any) -> str:  # noqa: ANN401 - MkDocs'
    """``{{commands}}`` and ``{{effects}}``, where a page asks for them."""
    if "{{commands}}" in markdown:
        markdown = markdown.replace("{{commands}}", commands())
    if "{{effects}}" in markdown:
        catalogue = ROOT / "sim2real" / "effects" / "README.md"
        _title, _, body = catalogue.read_text(encoding="utf-8").partition("\n")
        markdown = markdown.replace("{{effects}}", name_files(body, catalogue.parent))
    return markdown


def name_files(markdown: str, folder: Path) -> str:
    """Replace links to files of the repository, which no page links to, by their paths in it.

    Args:
        markdown: Text whose relative links start from ``folder``.
        folder: A folder of the repository, absolute.

    Raises:
        FileNotFoundError: If a link leads to no file.
    """

    def path_in_repository(link: re.Match[str]) -> str:
        return f"`{(folder / link[1]).resolve(strict=True).relative_to(ROOT)}`"

    return _FILE_LINK.sub(path_in_repository, markdown)


def commands() -> str:
    """The help of every command, as a terminal of 80 columns shows it: what a page has room for."""
    import os

    from sim2real.cli import COMMANDS, parser

    os.environ["COLUMNS"] = "80"
    (several,) = (a for a in parser()._actions if a.dest == "command")
    shown = []
    for name, (_home, said) in COMMANDS.items():
        text = several.choices[name].format_help()  # type: ignore[index, call-overload]
        shown.append(f"## {name}\n\n{said[0].upper()}{said[1:]}.\n\n```text\n{text}```\n")
    return "\n".join(shown)
