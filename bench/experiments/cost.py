"""What tasks have cost, so that a run can be planned."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .markdown import figure, table
from .results import load
from .tasks import Task

TITLE = "Cost of the tasks"
INTRODUCTION = """\
Processor time of this run's tasks, whenever they were run. What is timed for tables 4 and 5, maps of LAMM among it,
runs alone, two threads where it can; all else runs by itself on one.
"""
KINDS = (
    (r"drive-\d+", "drives"),
    (r"odometry-(.+)-timed-\d+", "timed odometry"),
    (r"odometry-(.+)-\d+", r"odometry \1"),
    (r"(streets|viewpoints)-.+", r"\1"),
    (r"(graph|growth)-.+", "drawn graphs"),
    (r".+-session\d+", "timed maps"),
    (r"(.+)", r"map \1"),
)


def kind_of(name: str) -> str:
    """What a task is for, by the last part of its name; the row of a map."""
    last = name.split("/")[-1]
    for pattern, kind in KINDS:
        if match := re.fullmatch(pattern, last):
            return match.expand(kind)
    return last


def world_of(name: str) -> str:
    return "/".join(part for part in name.split("/")[:-1] if not re.fullmatch(r"seed\d+", part))


def costs(tasks: Sequence[tuple[Task, Path]]) -> list[dict[str, Any]]:
    """By world and kind the number of tasks, seconds of processor time in all and of the longest.

    @param tasks  those that are done, with their folders.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for task, folder in tasks:
        commands = load(folder / "task.json")["commands"]
        seconds = sum(float(command["processor_seconds"]) for command in commands)
        key = (world_of(task.name), kind_of(task.name))
        entry = found.setdefault(key, {"world": key[0], "kind": key[1], "tasks": 0, "seconds": 0.0, "longest_s": 0.0})
        entry["tasks"] += 1
        entry["seconds"] += seconds
        entry["longest_s"] = max(entry["longest_s"], seconds)
    return list(found.values())


def markdown(entries: Sequence[Mapping[str, Any]]) -> str:
    def cells(entry: Mapping[str, Any]) -> list[str]:
        numbers = (entry["seconds"] / 60, entry["longest_s"] / 60)
        return [entry["kind"], str(entry["tasks"]), *(figure(number, 2) for number in numbers)]

    text = f"# {TITLE}\n\n{INTRODUCTION}"
    for world in dict.fromkeys(entry["world"] for entry in entries):
        own = [entry for entry in entries if entry["world"] == world]
        minutes = sum(entry["seconds"] for entry in own) / 60
        text += f"\n## {world}: {figure(minutes, 3)} minutes\n\n"
        text += table(["", "tasks", "minutes", "longest"], [cells(entry) for entry in own])
    return text
