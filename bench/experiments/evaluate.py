"""Errors of a map in the plane and in space, per frame of the map, as `chainslam eval` takes them.

A task runs it behind `chainslam map` (or `lamm`), whose summary says which sessions lie in one frame: those share one
alignment. Usage: python3 -m experiments.evaluate PROGRAM MAP SET...
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

PROJECTIONS = ("none", "xy")


def file_tags(names: Iterable[str]) -> list[str]:
    """What tells the files of a map's sessions apart, as the program names them."""
    names = list(names)
    if len(names) < 2:
        return [""] * len(names)
    tags: list[str] = []
    for name in names:
        tag = "." + re.sub(r"[^0-9A-Za-z_-]", "_", name or "session")
        count, unique = 2, tag
        while unique in tags:
            unique, count = f"{tag}-{count}", count + 1
        tags.append(unique)
    return tags


def trajectories(folder: Path, summary: dict[str, Any]) -> list[Path]:
    """The trajectory of each session that the run has mapped, not loaded."""
    mapped = [session["name"] for session in summary["sessions"] if not session.get("loaded", False)]
    return [folder / f"trajectory{tag}.tum" for tag in file_tags(mapped)]


def frames(summary: dict[str, Any]) -> list[list[int]]:
    """Positions of the sessions that were mapped, together where they lie in one frame."""
    mapped = [session for session in summary["sessions"] if not session.get("loaded", False)]
    groups: dict[int, list[int]] = {}
    for i, session in enumerate(mapped):
        groups.setdefault(session["frame"], []).append(i)
    return list(groups.values())


def sessions_of(folder: Path, sets: list[Path]) -> list[tuple[Path, Path, int]]:
    """Recording, trajectory and number of the frame of each session that was mapped."""
    summary = json.loads((folder / "summary.json").read_text())
    mapped = [session for session in summary["sessions"] if not session.get("loaded", False)]
    frames_ = [int(session["frame"]) for session in mapped]
    return list(zip(sets, trajectories(folder, summary), frames_, strict=True))


def evaluate(program: Path, folder: Path, sets: list[Path]) -> None:
    """Writes `errors.FRAME.none.json` and `errors.FRAME.xy.json` beside the map for each frame that has truth."""
    summary = json.loads((folder / "summary.json").read_text())
    files = trajectories(folder, summary)
    for number, group in enumerate(frames(summary)):
        pairs = [str(path) for i in group if (sets[i] / "truth.tum").is_file()
                 for path in (sets[i] / "truth.tum", files[i])]
        for projection in PROJECTIONS if pairs else ():
            out = folder / f"errors.{number}.{projection}.json"
            subprocess.run([program, "eval", *pairs, "--associate", "interpolate", "--project", projection,
                            "--json", out, "--overwrite"], check=True)


if __name__ == "__main__":
    evaluate(Path(sys.argv[1]), Path(sys.argv[2]), [Path(word) for word in sys.argv[3:]])
