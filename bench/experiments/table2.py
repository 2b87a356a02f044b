"""Table 2: clouds of single streets by the poses of a map, registered to those by true poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from .markdown import figure
from .results import Figures, Result, mean, number
from .table import Column, WorldNote, markdown_rows

TITLE = "Table 2: registration of streets"
INTRODUCTION = """\
Up to four straight streets of 50 m, those that most sessions drive, chosen by the true paths: all scans taken within 12 m
of the centre line, put together by the map's poses and by true ones, 0.3 m voxels. RMSE in metres of the distances
from each point to the nearest one of the true cloud: as the whole map's alignment puts it, after RANSAC on FPFH features
without a guess, and after ICP from there, all with fixed parameters and seeds. Sessions that do not lie in one frame make
clouds of their own, over which the mean is taken. Thickness: the mean over points of the least standard deviation of those
within 1 m; walls that are drawn twice are thick.
"""
QUANTITIES = {"aligned_m": "as aligned", "ransac_m": "RANSAC", "icp_m": "ICP", "thickness_m": "thickness"}
STREETS = 4


def columns() -> tuple[Column, ...]:
    """Means over the streets, then each street after RANSAC and ICP, as the paper's table has them."""
    means = tuple(Column(key, head) for key, head in QUANTITIES.items())
    each = tuple(Column(f"{key}_{i + 1}", f"{i + 1}: {QUANTITIES[key]}")
                 for i in range(STREETS) for key in ("ransac_m", "icp_m"))
    return (*means, Column("clouds", "clouds"), Column("not_found", "not found"), *each)


def figures(document: Mapping[str, Any]) -> Figures:
    """Of one map, from what `street_registration` has written."""
    found: Figures = {}
    clouds = [cloud for street in document["streets"] for cloud in street["clouds"]]
    for i, street in enumerate(document["streets"]):
        for key in QUANTITIES:
            found[f"{key}_{i + 1}"] = mean([number(cloud, key) for cloud in street["clouds"]])
    for key in QUANTITIES:
        found[key] = mean([found[f"{key}_{i + 1}"] for i in range(len(document["streets"]))])
    found["clouds"] = float(len(clouds))
    found["not_found"] = float(sum(math.isnan(number(cloud, "ransac_m")) for cloud in clouds))
    return found


def true_thickness(document: Mapping[str, Any]) -> float:
    return mean([number(street, "true_thickness_m") for street in document["streets"]])


def markdown(results: Sequence[Result], worlds: Sequence[WorldNote], floors: Mapping[str, tuple[int, float]]) -> str:
    """@param floors  of each world how many streets there are, and how thick surfaces are by true poses."""
    text = f"# {TITLE}\n\n{INTRODUCTION}"
    for world in worlds:
        if world.name not in floors:
            continue
        streets, thickness = floors[world.name]
        count = f"{streets} street" + ("" if streets == 1 else "s")
        text += f"\n## {world.name}\n\n{world.line()} {count}; thickness by true poses {figure(thickness)} m.\n\n"
        shown = tuple(c for c in columns() if not c.key[-1].isdigit() or int(c.key[-1]) <= streets)
        text += markdown_rows(results, world.name, shown)
    return text
