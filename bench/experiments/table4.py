"""Tables 4 and 5: what the last session costs on top of the others, and how that grows with sessions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .results import Result, number
from .table import Column, WorldNote, markdown_rows

TITLE = "Table 4: efficiency"
INTRODUCTION = """\
The last session with the map of all others loaded, by itself on all cores of the machine. Front end: odometry of its
first {scans} scans or fewer. Back end: search, registration, chaining, merging and optimization, in total, for each
keyframe and for each raw scan. FPS: 1000 / (front end + back end, ms per scan, means). Memory: peak resident set of the
process that maps. LAMM loads no map: its process maps all sessions, and its times are of all of them.
"""
COLUMNS = (
    Column("front_mean_ms", "front ms/scan"),
    Column("front_p99_ms", "p99"),
    Column("front_max_ms", "max"),
    Column("scan_back_ms", "back ms/scan"),
    Column("keyframe_mean_ms", "back ms/keyframe"),
    Column("keyframe_p50_ms", "p50"),
    Column("keyframe_p99_ms", "p99"),
    Column("keyframe_max_ms", "max"),
    Column("fps", "FPS"),
    Column("alignments", "alignments", 4),
    Column("peak_memory_bytes", "memory MB", 3, 1e-6),
    Column("map_bytes", "map MB", 3, 1e-6),
)
GROWTH_TITLE = "Table 5: growth"
GROWTH_INTRODUCTION = """\
The same for each session in turn, each in a process of its own that loads the map of those before.
"""
DRAWN_TITLE = "Growth on drawn graphs"
DRAWN_INTRODUCTION = """\
{sessions} sessions that drive the same paths in turn, on graphs that are drawn as for the table of drawn graphs: what the
back end costs without its alignments. Memory is that of the whole process so far.
"""
DRAWN_COLUMNS = (
    Column("keyframes", "keyframes in all", 5),
    Column("closures", "closures", 5),
    Column("keyframe_mean_ms", "ms/keyframe"),
    Column("keyframe_p99_ms", "p99"),
    Column("keyframe_max_ms", "max"),
    Column("peak_memory_bytes", "memory MB", 3, 1e-6),
)
SHOWN_SESSIONS = (1, 2, 3, 5, 9, 18, 27)
GROWTH_COLUMNS = (
    Column("keyframes", "keyframes in all", 4),
    Column("keyframe_mean_ms", "ms/keyframe"),
    Column("keyframe_p99_ms", "p99"),
    Column("keyframe_max_ms", "max"),
    Column("alignments", "alignments", 4),
    Column("peak_memory_bytes", "memory MB", 3, 1e-6),
    Column("map_bytes", "map MB", 3, 1e-6),
    Column("wall_s", "whole run s"),
)


def drawn_results(document: Mapping[str, Any], world: str, row: str) -> list[Result]:
    """One result for each of the sessions that are shown."""
    return [
        Result(world, f"{row}, session {one['session']}", 1, {c.key: number(one, c.key) for c in DRAWN_COLUMNS})
        for one in document["growth"]
        if one["session"] in SHOWN_SESSIONS
    ]


def markdown(
    title: str, introduction: str, columns: Sequence[Column], results: Sequence[Result], worlds: Sequence[WorldNote]
) -> str:
    text = f"# {title}\n\n{introduction}"
    for world in worlds:
        text += f"\n## {world.name}\n\n{world.line()}\n\n" + markdown_rows(results, world.name, columns)
    return text
