"""Puts results into README.md, between markers; results of other worlds that stand there stay."""

from __future__ import annotations

from pathlib import Path

README = Path(__file__).with_name("README.md")


class MarkerError(Exception):
    """The text has no place for a result."""


def file_name(table: str) -> str:
    return f"table{table}" if table.isdigit() else table


def marker(name: str, size: str, end: bool = False) -> str:
    return f"<!-- {'end' if end else 'begin'} {name} {size} -->"


def sections(block: str) -> dict[str, dict[str, str]]:
    """What stands between two markers: by title, and in it by world, headings included; "" is what precedes the worlds."""
    found: dict[str, dict[str, str]] = {}
    title = world = ""
    for line in block.strip().splitlines():
        if line.startswith("## "):
            title, world = line, ""
        elif line.startswith("### "):
            world = line.removeprefix("### ").split(": ")[0]
        worlds = found.setdefault(title, {})
        worlds[world] = worlds[world] + "\n" + line if world in worlds else line
    return found


def merged(old: str, new: str) -> str:
    """`new`, and of `old` what is of worlds that `new` does not have."""
    before = sections(old)
    parts = [before.get(title, {}) | worlds for title, worlds in sections(new).items()]
    return "\n\n".join(text.strip() for worlds in parts for text in worlds.values())


def places(text: str, name: str, size: str) -> tuple[int, int]:
    """Where a result begins and ends."""
    begin, end = marker(name, size), marker(name, size, end=True)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise MarkerError(f"README.md needs one line {begin} and one line {end} behind it")
    return text.index(begin) + len(begin), text.index(end)


def with_result(text: str, name: str, size: str, result: str) -> str:
    """The text with a result between its markers, merged with what stood there; its headings one level lower."""
    first, last = places(text, name, size)
    lowered = "\n".join("#" + line if line.startswith("#") else line for line in result.strip().splitlines())
    return text[:first] + "\n" + merged(text[first:last], lowered) + "\n" + text[last:]


def insert(path: Path, name: str, size: str, result: str) -> None:
    from .table import write_text  # which needs numpy

    write_text(path, with_result(path.read_text(), name, size, result))
