"""What a run came to, read from the files that the programs wrote."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .evaluate import frames

HASH_NOTE = "options of the simulation: "
Figures = dict[str, float]


@dataclass(frozen=True)
class Result:
    """Figures of one row in one world by one seed; NaN where a run has none."""

    world: str
    row: str
    seed: int
    figures: Figures = field(default_factory=dict)


def load(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def number(document: Any, *keys: str) -> float:
    """The number at a path of keys; NaN if there is none."""
    for key in keys:
        if not isinstance(document, dict) or key not in document:
            return math.nan
        document = document[key]
    return float(document) if isinstance(document, (int, float)) else math.nan


def options_hash(recording: Path) -> str:
    """Of the world that a recording is from; empty if it was not simulated."""
    for note in load(recording / "summary.json")["notes"]:
        if note.startswith(HASH_NOTE):
            return str(note.removeprefix(HASH_NOTE))
    return ""


def pooled(folder: Path, groups: int, projection: str, quantity: str) -> float:
    """RMSE over all frames of a map, each under one alignment: squares weigh as many poses as they are of."""
    squares, count = 0.0, 0
    for group in range(groups):
        file = folder / f"errors.{group}.{projection}.json"
        if file.is_file():
            ape = load(file)["ape"]
            squares += ape["count"] * ape[quantity]["rmse"] ** 2
            count += ape["count"]
    return math.sqrt(squares / count) if count else math.nan


def mean(values: list[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def by_session(summary: dict[str, Any], quantity: str) -> float:
    """Mean over the sessions of the RMSE under an alignment of each one's own."""
    return mean([number(s, "errors", "optimized", "ape", quantity, "rmse") for s in summary["sessions"]])


def errors(folder: Path) -> Figures:
    """Table 1's figures of a map: RMSE in metres and degrees."""
    summary = load(folder / "summary.json")
    groups = frames(summary)
    closures = summary.get("closures", {})
    return {
        "ape_2d_m": pooled(folder, len(groups), "xy", "translation"),
        "ape_2d_deg": pooled(folder, len(groups), "xy", "rotation_deg"),
        "ape_3d_m": number(summary, "errors", "optimized", "ape", "translation", "rmse"),
        "ape_3d_deg": number(summary, "errors", "optimized", "ape", "rotation_deg", "rmse"),
        "session_3d_m": by_session(summary, "translation"),
        "session_3d_deg": by_session(summary, "rotation_deg"),
        "between_m": number(summary, "errors", "inter_session", "rpe", "translation", "rmse"),
        "between_deg": number(summary, "errors", "inter_session", "rpe", "rotation_deg", "rmse"),
        "between_median_m": number(summary, "errors", "inter_session", "rpe", "translation", "median"),
        "pairs": number(summary, "errors", "inter_session", "rpe", "pairs"),
        "frames": float(len(groups)),
        "direct": number(closures, "direct"),
        "chained": number(closures, "chained"),
        "merges": number(closures, "merge"),
    }


def recording_figures(folders: list[Path]) -> Figures:
    """Of all recordings of a world: how long the way is, and how many scans odometry has lost."""
    summaries = [load(folder / "summary.json") for folder in folders]
    scans = sum(summary["scans"] for summary in summaries)
    lost = sum(number(summary, "frames", "lost") for summary in summaries)
    return {
        "path_m": sum(number(summary, "path_length_m") for summary in summaries),
        "scans": float(scans),
        "lost_share": lost / scans if scans else math.nan,
    }


def stage(summary: dict[str, Any], name: str, prefix: str) -> Figures:
    """Milliseconds of a stage: mean, median, 99 %, most."""
    total, count = number(summary, "stages", name, "total_s"), number(summary, "stages", name, "count")
    return {
        f"{prefix}_mean_ms": 1e3 * total / count if count > 0 else math.nan,
        f"{prefix}_p50_ms": number(summary, "stages", name, "p50_ms"),
        f"{prefix}_p99_ms": number(summary, "stages", name, "p99_ms"),
        f"{prefix}_max_ms": number(summary, "stages", name, "max_ms"),
    }


LAMM_STAGES = ("describe", "search", "optimize")  # which take the place of "back end"


def back_end(summary: dict[str, Any], scans: float) -> Figures:
    """Milliseconds of the back end for each keyframe and for each scan of odometry."""
    total = number(summary, "stages", "back end", "total_s")
    if math.isnan(total):
        total = sum(number(summary, "stages", name, "total_s") for name in LAMM_STAGES)
    one_by_one = number(summary, "back_end", "keyframes") > 0  # LAMM takes all keyframes together
    per_keyframe = summary["back_end"].get("per_keyframe", {}) if one_by_one else {}
    keyframes = number(summary, "back_end", "keyframes") if one_by_one else number(summary, "keyframes")
    return {
        "keyframe_mean_ms": 1e3 * total / keyframes if keyframes > 0 else math.nan,
        "keyframe_p50_ms": number(per_keyframe, "p50_ms"),
        "keyframe_p99_ms": number(per_keyframe, "p99_ms"),
        "keyframe_max_ms": number(per_keyframe, "max_ms"),
        "scan_back_ms": 1e3 * total / scans if scans > 0 else math.nan,
        "alignments": number(summary, "back_end", "alignments"),
    }


def resources(task: Path) -> Figures:
    """Peak memory of a task's mapping by its own account, bytes, and the size of the map that it wrote, if any."""
    record = load(task / "task.json")
    size = task / "map/map.cslam"
    return {
        "peak_memory_bytes": number(load(task / "map/summary.json"), "peak_memory_bytes"),
        "wall_s": sum(float(command["wall_seconds"]) for command in record["commands"]),
        "map_bytes": float(size.stat().st_size) if size.is_file() else math.nan,
    }
