"""Table 1: absolute pose errors in the plane and in space, and beside them errors between sessions."""

from __future__ import annotations

from collections.abc import Sequence

from .results import Result
from .table import Column, Compared, WorldNote, comparisons, markdown_with_differences

TITLE = "Table 1: pose errors"
INTRODUCTION = """\
RMSE in metres and degrees, mean over seeds (least..largest). APE as evo takes it: poses matched by time, sessions that
lie in one frame under one rigid alignment; 2-D: poses projected to the plane before it. Each session: the mean over
sessions, each under an alignment of its own. Between sessions: relative pose error of keyframes of different sessions
that stood within 5 m and 45 degrees of each other, without any alignment. Frames: how many the sessions lie in at the
end; errors between those are not counted, and a map in one frame has less freedom than one in several.
"""
COLUMNS = (
    Column("ape_2d_m", "2-D m"),
    Column("ape_2d_deg", "2-D deg"),
    Column("ape_3d_m", "3-D m"),
    Column("ape_3d_deg", "3-D deg"),
    Column("session_3d_m", "each session m"),
    Column("session_3d_deg", "deg"),
    Column("between_m", "between sessions m"),
    Column("between_deg", "deg"),
    Column("frames", "frames"),
    Column("direct", "direct", 4),
    Column("chained", "chained", 4),
)
COMPARED = ("ape_2d_m", "ape_3d_m", "ape_3d_deg", "session_3d_m", "between_m")
HEADS = {"ape_2d_m": "2-D m", "ape_3d_m": "3-D m", "ape_3d_deg": "3-D deg", "session_3d_m": "each session m",
         "between_m": "between sessions m"}
NEIGHBOURS = (
    ("unchained", "fast-lio2"),
    ("unchained", "lamm"),
    ("unchained", "lamm-as-released"),
    ("chained", "unchained"),
    ("chained", "released"),
    ("best", "best-unchained"),
    ("best", "chained"),
    ("best-own", "best"),
)

def neighbours(rows: Sequence[str]) -> list[tuple[str, str]]:
    """The pairs of rows that are compared: neighbours, and `best` with its ablations."""
    return [*NEIGHBOURS, *(("best", row) for row in rows if row.startswith("ablation-"))]


def compare_neighbours(results: Sequence[Result], worlds: Sequence[WorldNote], figures: Sequence[str]) -> Compared:
    """Figures of neighbouring rows, of each world that has several seeds."""
    pairs = neighbours(list(dict.fromkeys(result.row for result in results)))
    return {world.name: comparisons(results, world.name, pairs, figures) for world in worlds if world.seeds > 1}


def compare(results: Sequence[Result], worlds: Sequence[WorldNote]) -> Compared:
    return compare_neighbours(results, worlds, COMPARED)


def markdown(results: Sequence[Result], worlds: Sequence[WorldNote], compared: Compared, definitions: str = "") -> str:
    """@param definitions  of the rows."""
    differences = "Differences of neighbouring rows, seed by seed; negative where the first has the smaller error"
    return markdown_with_differences(
        f"# {TITLE}\n\n{INTRODUCTION}{definitions}", results, worlds, COLUMNS, compared, HEADS, differences
    )
