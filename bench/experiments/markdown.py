"""Tables as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence


def figure(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, never in powers of ten; whole ones as counts; a dash for none."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if value == int(value):
        return f"{value:.0f}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}"


def spread(values: Sequence[float], digits: int = 3) -> str:
    """The mean over seeds, and the least and largest if there are several."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return "-"
    text = figure(sum(known) / len(known), digits)
    if len(values) > 1:
        text += f" ({figure(min(known), digits)}..{figure(max(known), digits)}"
        text += f"; {len(known)} of {len(values)})" if len(known) < len(values) else ")"
    return text


def interval(bounds: tuple[float, float], digits: int = 3) -> str:
    low, high = bounds
    return "-" if math.isnan(low) or math.isnan(high) else f"{figure(low, digits)} .. {figure(high, digits)}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, columns as wide as they must be."""
    cells = [list(head), *[list(row) for row in rows]]
    widths = [max(3, *(len(row[i]) for row in cells)) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"

    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join([line(cells[0]), rule, *map(line, cells[1:])]) + "\n"
