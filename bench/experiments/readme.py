"""Puts results into README.md, between markers."""

from __future__ import annotations

from pathlib import Path

from .table import write_text


class MarkerError(Exception):
    """The text has no place for a result."""


def marker(name: str, size: str, end: bool = False) -> str:
    return f"<!-- {'end' if end else 'begin'} {name} {size} -->"


def with_result(text: str, name: str, size: str, result: str) -> str:
    """The text with what stands between the markers of a result replaced by it; its headings one level lower."""
    begin, end = marker(name, size), marker(name, size, end=True)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise MarkerError(f"README.md needs one line {begin} and one line {end} behind it")
    lowered = "\n".join("#" + line if line.startswith("#") else line for line in result.strip().splitlines())
    return text[: text.index(begin) + len(begin)] + "\n" + lowered + "\n" + text[text.index(end) :]


def insert(path: Path, name: str, size: str, result: str) -> None:
    write_text(path, with_result(path.read_text(), name, size, result))
