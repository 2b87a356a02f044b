"""The table of drawn graphs: many worlds, paired over rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from .markdown import figure
from .markdown import table as markdown_table
from .results import Result, number
from .table import Column, Compared, WorldNote, comparisons, markdown_comparisons, markdown_rows

TITLE = "Drawn graphs: statistics over paired seeds"
INTRODUCTION = """\
The true paths of each world's sessions with odometry errors drawn from those measured on its recordings (blocks of 25
keyframes of one session, so that correlation along the way stays), and the library's back end with alignments drawn
from those that the run with scans has made over like true distances: refused and false ones come as often as they did
there. `unchained` and `chained` draw from the run of `chained`, both rows of `best` from that of `best`; the same seed
has the same odometry in all rows, and the same pair of keyframes the same alignment in rows of one source. Errors as in
table 1, of keyframes. A false closure is off by more than 1 m or 0.1 rad.
"""
COLUMNS = (
    Column("ape_2d_m", "2-D m"),
    Column("ape_3d_m", "3-D m"),
    Column("ape_3d_deg", "3-D deg"),
    Column("between_m", "between sessions m"),
    Column("between_deg", "deg"),
    Column("frames", "frames"),
    Column("direct", "direct", 4),
    Column("chained", "chained", 4),
    Column("false", "false"),
)
COMPARED = ("ape_2d_m", "ape_3d_m", "ape_3d_deg", "between_m")
HEADS = {"ape_2d_m": "2-D m", "ape_3d_m": "3-D m", "ape_3d_deg": "3-D deg", "between_m": "between sessions m"}
PAIRS = (("chained", "unchained"), ("best", "best-unchained"), ("best", "chained"))


def results_of(document: Mapping[str, Any], world: str, row: str) -> list[Result]:
    """One result for each drawn world."""
    return [
        Result(world, row, int(seed["seed"]), {c.key: number(seed, c.key) for c in COLUMNS}) for seed in document["seeds"]
    ]


def compare(results: Sequence[Result], worlds: Sequence[WorldNote]) -> Compared:
    return {world.name: comparisons(results, world.name, PAIRS, COMPARED) for world in worlds}


def measured(statistics: Mapping[str, Mapping[str, Any]]) -> str:
    """What the graphs are drawn from, by the row that was measured."""
    rows = []
    for row, found in statistics.items():
        for kind in ("closures", "merges"):
            counts = found[kind]
            tried, converged = number(counts, "tried"), number(counts, "converged")
            wrong = number(counts, "false") / converged if converged else math.nan
            rows.append([row, kind, figure(tried), figure(100 * converged / tried if tried else math.nan),
                         figure(100 * wrong), figure(number(counts, "rms_m")), figure(number(counts, "rms_deg"))])
    head = ["run", "alignments", "tried", "accepted %", "of these false %", "rms of right ones m", "deg"]
    steps: Mapping[str, Any] = next(iter(statistics.values()), {})
    text = markdown_table(head, rows)
    text += f"\nOdometry from keyframe to keyframe: {figure(number(steps, 'step_rms_m'))} m and "
    text += f"{figure(number(steps, 'step_rms_deg'))} deg rms, correlation with the next step "
    text += f"{figure(number(steps, 'next_step_correlation'), 2)} and "
    return text + f"{figure(number(steps, 'next_step_correlation_rotation'), 2)}.\n"


def markdown(
    results: Sequence[Result],
    worlds: Sequence[WorldNote],
    compared: Compared,
    statistics: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> str:
    text = f"# {TITLE}\n\n{INTRODUCTION}"
    for world in worlds:
        if world.name not in statistics:
            continue
        text += f"\n## {world.name}\n\n{world.line()}\n\n" + measured(statistics[world.name])
        text += "\nMean over seeds (least..largest):\n\n" + markdown_rows(results, world.name, COLUMNS)
        text += "\nDifferences, seed by seed; negative where the first has the smaller error:\n\n"
        text += markdown_comparisons(compared[world.name], HEADS)
    return text
