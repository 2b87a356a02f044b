"""What all tables have in common: results by world and row, their comparison, and how both are written."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .markdown import figure, interval, spread, table
from .paired import Paired, paired
from .results import Result


# By world: a, b, figure, and what the seeds say of a - b.
Compared = dict[str, Sequence[tuple[str, str, str, Paired]]]


@dataclass(frozen=True)
class Column:
    """A figure of a table."""

    key: str
    head: str
    digits: int = 3
    scale: float = 1.0


@dataclass(frozen=True)
class WorldNote:
    """What is said of a world above its rows."""

    name: str
    options: str  # hash of the simulator's options; empty if it was recorded
    sessions: int
    seeds: int
    path_m: float = math.nan
    scans: float = math.nan
    lost_share: float = math.nan

    def line(self) -> str:
        origin = f"simulated, options `{self.options}`" if self.options else "recorded"
        text = f"{origin}; {self.sessions} sessions"
        if self.seeds > 1:
            text += f", {self.seeds} seeds"
        if not math.isnan(self.path_m):
            text += f"; of each seed on average {figure(self.path_m / 1000)} km and {figure(self.scans, 4)} scans"
            text += f", of which FAST-LIO2 lost {figure(100 * self.lost_share, 2)} %"
        return text + "."


def rows_of(results: Sequence[Result], world: str) -> list[str]:
    return list(dict.fromkeys(result.row for result in results if result.world == world))


def values(results: Sequence[Result], world: str, row: str, key: str) -> list[float]:
    """One figure for each seed that the world has, whichever of them the row has: NaN for those that failed."""
    seeds = sorted({result.seed for result in results if result.world == world})
    found = {r.seed: r.figures.get(key, math.nan) for r in results if (r.world, r.row) == (world, row)}
    return [found.get(seed, math.nan) for seed in seeds]


def markdown_rows(results: Sequence[Result], world: str, columns: Sequence[Column]) -> str:
    rows = [
        [row, *(spread([c.scale * v for v in values(results, world, row, c.key)], c.digits) for c in columns)]
        for row in rows_of(results, world)
    ]
    return table(["", *(column.head for column in columns)], rows)


def comparisons(
    results: Sequence[Result], world: str, pairs: Sequence[tuple[str, str]], keys: Sequence[str]
) -> list[tuple[str, str, str, Paired]]:
    """a - b of each pair of rows and each figure, seed by seed."""
    rows = rows_of(results, world)
    return [
        (a, b, key, paired(values(results, world, a, key), values(results, world, b, key)))
        for a, b in pairs
        if a in rows and b in rows
        for key in keys
    ]


def markdown_comparisons(found: Sequence[tuple[str, str, str, Paired]], heads: dict[str, str]) -> str:
    """Rows "a - b": negative where a has the smaller error."""
    rows = [
        [f"{a} - {b}", heads[key], str(p.pairs), f"{p.smaller} / {p.larger}", figure(p.sign_test_p),
         figure(p.mean), interval(p.mean_interval), figure(p.median), interval(p.median_interval)]
        for a, b, key, p in found
    ]
    head = ["a - b", "of", "pairs", "a smaller / larger", "sign test p", "mean", "95 % (t)", "median", "95 % (ranks)"]
    return table(head, rows)


def markdown_with_differences(
    head: str,
    results: Sequence[Result],
    worlds: Sequence[WorldNote],
    columns: Sequence[Column],
    compared: Compared,
    heads: dict[str, str],
    differences: str,
) -> str:
    """The rows of each world and, if it has several seeds, how neighbouring rows differ; `differences` introduces that."""
    text = head
    for world in worlds:
        text += f"\n## {world.name}\n\n{world.line()}\n\n" + markdown_rows(results, world.name, columns)
        if compared.get(world.name):
            text += f"\n{differences}:\n\n" + markdown_comparisons(compared[world.name], heads)
    return text


def plain(value: Any) -> Any:
    """Without NaN, which JSON does not have."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def write_json(path: Path, document: dict[str, Any]) -> None:
    _write(path, json.dumps(plain(document), indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    _write(path, text)


def _write(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    part.rename(path)


def document(
    name: str,
    about: dict[str, Any],
    worlds: Sequence[WorldNote],
    results: Sequence[Result],
    compared: Compared,
) -> dict[str, Any]:
    """A table for programs to read."""
    return {
        "table": name,
        **about,
        "worlds": [asdict(world) for world in worlds],
        "results": [asdict(result) for result in results],
        "comparisons": [
            {"world": world, "a": a, "b": b, "figure": key, **asdict(p)}
            for world, found in compared.items()
            for a, b, key, p in found
        ],
    }


