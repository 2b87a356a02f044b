"""Table 3: views rendered from a map at the estimated poses of keyframes that are not in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .results import Figures, Result, number
from .table import Column, Compared, WorldNote, markdown_with_differences
from .table1 import compare_neighbours

TITLE = "Table 3: viewpoints"
INTRODUCTION = """\
The tenth part of each session's keyframes (the 6th, 16th, 26th ...) is held out. At the pose that the map has for one, the scans of all
others in its frame are rendered as a panorama of ranges and one of intensities, and compared with the scan that was taken there: 360 x 45
pixels of 1 degree, elevations from -30 to 15 degrees. The map's scans are downsampled to 0.2 m (means of positions and of intensities), and
their points are drawn 0.3 m large, so that near surfaces have no holes. Seen is the nearest range that two scans have within 0.5 m of each
other, their mean, and the mean intensity of these two; where there is none such, the nearest: what passed one scan alone is not in the way.
Values from 0 to 1 are ranges divided by 50 m, what is farther is nothing; and intensities, as recorded, divided by the 99th percentile of
the pixels of the scan that was taken there, which is 1 as is what exceeds it. Compared are the pixels in which the scan has a return; where
the map has none (uncovered: their share), its range is 1 and its intensity 0. Without intensities in all recordings there are none here.
PSNR: 10 log10(1 / mean squared difference), dB. Loss: 0.8 mean absolute difference + 0.2 (1 - SSIM), as 3-D Gaussian splatting has it, SSIM with windows of 11 x 11
pixels over those that count. Means over views. Rows whose sessions lie in as many frames can be compared: a frame of one session is a map of
one day, without the cars and leaves of others.
"""
COLUMNS = (
    Column("psnr_db", "range PSNR dB", 4),
    Column("loss", "range loss"),
    Column("intensity_psnr_db", "intensity PSNR dB", 4),
    Column("intensity_loss", "intensity loss"),
    Column("uncovered", "uncovered %", 2, 100.0),
    Column("views", "views", 4),
)
COMPARED = ("psnr_db", "loss", "intensity_psnr_db", "intensity_loss")
HEADS = {column.key: column.head for column in COLUMNS if column.key in COMPARED}


def figures(document: Mapping[str, Any]) -> Figures:
    """Of one map, from what `viewpoints` has written."""
    return {column.key: number(document, column.key) for column in COLUMNS}


def compare(results: Sequence[Result], worlds: Sequence[WorldNote]) -> Compared:
    return compare_neighbours(results, worlds, COMPARED)


def markdown(results: Sequence[Result], worlds: Sequence[WorldNote], compared: Compared) -> str:
    differences = "Differences, seed by seed; a larger PSNR and a smaller loss are better"
    return markdown_with_differences(
        f"# {TITLE}\n\n{INTRODUCTION}", results, worlds, COLUMNS, compared, HEADS, differences
    )
