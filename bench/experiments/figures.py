"""Pictures beside the tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402

from .evaluate import frames, trajectories  # noqa: E402
from .results import Result, load  # noqa: E402
from .table import rows_of, values  # noqa: E402

Array = npt.NDArray[np.float64]


def positions(path: Path) -> tuple[Array, Array]:
    """Times (n) and positions (n x 3) of a TUM trajectory."""
    rows = np.loadtxt(path, ndmin=2)
    return rows[:, 0], rows[:, 1:4]


def aligned(folder: Path, sets: Sequence[Path]) -> list[tuple[Array, Array, Array]]:
    """For each session with truth its times, positions in the truth's frame and the true ones at these times.

    The alignment is the one that `chainslam eval` has written beside the map.
    """
    summary = load(folder / "summary.json")
    files = trajectories(folder, summary)
    found = []
    for number, group in enumerate(frames(summary)):
        written = folder / f"errors.{number}.none.json"
        if not written.is_file():
            continue
        T = np.array(load(written)["alignment"]["T_reference_estimate"]).reshape(4, 4)
        for i in group:
            if not (sets[i] / "truth.tum").is_file():
                continue
            times, estimate = positions(files[i])
            truth_times, truth = positions(sets[i] / "truth.tum")
            inside = (times >= truth_times[0]) & (times <= truth_times[-1])
            times, estimate = times[inside], estimate[inside] @ T[:3, :3].T + T[:3, 3]
            true = np.stack([np.interp(times, truth_times, truth[:, axis]) for axis in range(3)], axis=1)
            found.append((times, estimate, true))
    return found


def _save(figure: plt.Figure, folder: Path, world: str, name: str) -> None:
    figure.savefig(folder / f"{world.replace('/', '-')}-{name}.png", dpi=110, bbox_inches="tight")
    plt.close(figure)


def _grid(count: int) -> tuple[int, int]:
    columns = min(4, max(1, count))
    return columns, math.ceil(count / columns)


def paths(maps: Mapping[str, Path], sets: Mapping[str, Sequence[Path]], world: str, folder: Path) -> None:
    """Each row's paths from above over the true ones."""
    shown = {row: sessions for row, path in maps.items() if (sessions := aligned(path, sets[row]))}
    if not shown:
        return
    columns, lines = _grid(len(shown))
    figure, axes = plt.subplots(lines, columns, figsize=(4 * columns, 4 * lines), squeeze=False)
    for axis in axes.flat[len(shown) :]:
        axis.axis("off")
    for axis, (row, sessions) in zip(axes.flat, shown.items()):
        for i, (_, _, true) in enumerate(sessions):
            axis.plot(true[:, 0], true[:, 1], color="0.7", linewidth=3, label="truth" if i == 0 else None)
        for i, (_, estimate, _) in enumerate(sessions):
            axis.plot(estimate[:, 0], estimate[:, 1], linewidth=1, label=f"session {i + 1}")
        axis.set_title(row)
        axis.set_aspect("equal", "datalim")
    axes.flat[0].legend(fontsize="small")
    figure.suptitle(f"{world}, seed 1: paths from above, metres", y=1.0 + 0.1 / lines)
    _save(figure, folder, world, "paths")


def errors_over_distance(
    maps: Mapping[str, Path], sets: Mapping[str, Sequence[Path]], world: str, folder: Path
) -> None:
    """Distance from the truth along the way of all sessions, one after the other."""
    figure, axis = plt.subplots(figsize=(10, 4))
    drawn = False
    for row, path in maps.items():
        distance, error, before = [], [], 0.0
        for _, estimate, true in aligned(path, sets[row]):
            steps = np.linalg.norm(np.diff(true, axis=0), axis=1)
            along = before + np.concatenate([[0.0], np.cumsum(steps)])
            before = float(along[-1])
            distance += [*along, np.nan]
            error += [*np.linalg.norm(estimate - true, axis=1), np.nan]
        if distance:
            axis.plot(distance, error, linewidth=1, label=row)
            drawn = True
    axis.set_yscale("log")
    axis.set_xlabel("metres along all sessions")
    axis.set_ylabel("metres from the truth")
    axis.set_title(f"{world}, seed 1: error over distance")
    if drawn:
        axis.legend(fontsize="small", ncols=2)
        _save(figure, folder, world, "error-over-distance")
    plt.close(figure)


def box_plots(results: Sequence[Result], world: str, folder: Path) -> None:
    """Spread over seeds of the main errors, for each row."""
    rows = rows_of(results, world)
    quantities = {"ape_3d_m": "APE 3-D, m", "ape_2d_m": "APE 2-D, m", "between_m": "between sessions, m"}
    figure, axes = plt.subplots(1, len(quantities), figsize=(5 * len(quantities), 0.4 * len(rows) + 1.5), sharey=True)
    for axis, (key, title) in zip(axes, quantities.items()):
        samples = [[v for v in values(results, world, row, key) if not math.isnan(v)] for row in rows]
        axis.boxplot(samples, vert=False, whis=(0, 100))
        axis.set_yticks(range(1, len(rows) + 1), rows)
        axis.set_title(title)
        if any(samples):
            axis.set_xscale("log")
    axes[0].invert_yaxis()
    figure.suptitle(f"{world}: over seeds", y=1.0 + 0.4 / figure.get_figheight())
    _save(figure, folder, world, "seeds")


def panoramas(views: Mapping[str, Mapping[str, Any]], world: str, folder: Path) -> None:
    """One held-out keyframe: its scan, and what is rendered from each row's map where the map has it: as ranges and, if
    all have them, as intensities.

    @param views  by row what `viewpoints` shows.
    """
    first = next(iter(views.values()))
    kinds = [("", 50.0, "viridis", "metres")]
    if all("scan_intensities" in view for view in views.values()):
        kinds.append(("_intensities", 1.0, "gray", "intensity (1: 99th percentile)"))

    def image(view: Mapping[str, Any], key: str, most: float) -> Array:
        pixels = np.array(view[key], dtype=float).reshape(view["rows"], view["columns"])
        return np.where(pixels < 0, np.nan, pixels / 255 * most)

    lines = len(views) + 1
    figure, axes = plt.subplots(lines, len(kinds), figsize=(9 * len(kinds), 1.5 * lines), squeeze=False)
    for column, (kind, most, colours, label) in zip(axes.T, kinds, strict=True):
        images = {"scan": image(first, "scan" + kind, most)}
        images |= {row: image(view, "rendered" + kind, most) for row, view in views.items()}
        for axis, (row, values_) in zip(column, images.items(), strict=True):
            drawn = axis.imshow(values_, vmin=0, vmax=most, cmap=colours, extent=(180, -180, -30, 15), aspect="auto",
                                interpolation="nearest")
            axis.set_facecolor("tab:blue" if kind else "white")  # where there is nothing
            axis.set_title(row, fontsize="small", loc="left")
            axis.set_xticks([])
            axis.set_yticks([-30, 0, 15])
        figure.colorbar(drawn, ax=column.tolist(), label=label)
    figure.suptitle(f"{world}, seed 1, session {first['session']}: a keyframe that is not in the map", y=0.99)
    _save(figure, folder, world, "viewpoints")
