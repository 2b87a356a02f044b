"""Markdown tables of Google Benchmark's JSON files: one table per module, with the speedup over each peer.

usage: python3 -m benchmark_tables OUT COMMAND PROGRAMS FILE...
COMMAND: how they were made; PROGRAMS: the compiler and the peers, with versions; FILE: MODULE.json, or MODULE_plain.json of
the build for plain x86-64.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

from experiments.markdown import figure

SPEEDUP = "speedup_vs_"
# What Google Benchmark writes of every run, beside its counters.
STANDARD = {
    "name", "family_index", "per_family_instance_index", "run_name", "run_type", "repetitions", "repetition_index",
    "threads", "iterations", "real_time", "cpu_time", "time_unit", "label", "items_per_second", "bytes_per_second",
}


def processor() -> str:
    try:
        found = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    return found.group(1) if found else "unknown processor"


def rows_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [run for run in document.get("benchmarks", []) if run.get("run_type", "iteration") == "iteration"]


def time_of_ours(row: dict[str, Any]) -> str:
    """A benchmark that measures by itself (`manual_time`) or by the clock on the wall says so in its name."""
    clock = "real_time" if re.search(r"/(manual|real)_time", row["name"]) else "cpu_time"
    return f"{figure(row[clock])} {row['time_unit']}"


def name_of(row: dict[str, Any]) -> str:
    return re.sub(r"/((manual|real|process)_time|iterations:\d+)", "", row["name"])


def speedup(value: float) -> str:
    return f"**{figure(value)}**" if value < 1 else figure(value)


def table(rows: list[dict[str, Any]]) -> str:
    """Time of ours, how many times longer each peer takes, and all other counters."""
    peers = list(dict.fromkeys(key for row in rows for key in row if key.startswith(SPEEDUP)))
    lines = ["| benchmark | ours | " + "".join(f"{peer[len(SPEEDUP):]} | " for peer in peers) + "figures |"]
    lines.append("|---|---|" + "---|" * len(peers) + "---|")
    for row in rows:
        others = [
            f"{key} {figure(value)}"
            for key, value in row.items()
            if key not in STANDARD and key not in peers and isinstance(value, (int, float)) and not isinstance(value, bool)
        ]
        cells = [f"`{name_of(row)}`", time_of_ours(row)]
        cells += [speedup(row[peer]) if peer in row else "" for peer in peers]
        lines.append("| " + " | ".join([*cells, ", ".join(others)]) + " |")
    return "\n".join(lines) + "\n"


def document_of(command: str, programs: str, files: list[Path]) -> str:
    text = ""
    date = ""
    for file in sorted(files):
        content = file.read_text()
        if not content.strip():
            continue  # no benchmark of this module was asked for
        document = json.loads(content)
        rows = rows_of(document)
        if not rows:
            continue
        date = date or str(document["context"]["date"])[:10]
        module, plain = file.stem.removesuffix("_plain"), file.stem.endswith("_plain")
        text += f"\n## {module}{', plain x86-64' if plain else ''}\n\n" + table(rows)
    machine = f"{processor()}, {os.cpu_count()} cores"
    return (
        f"# Benchmarks of {date}\n\n`{command}`\n\n{machine}; {programs}.\n\n"
        "Times are processor time of the thread; of files and of several threads, wall time. A number in a peer's column is the "
        "peer's time divided by ours: below 1, in bold, the peer is faster.\n" + text
    )


def main(arguments: list[str]) -> int:
    if len(arguments) < 4:
        print(__doc__, file=sys.stderr)
        return 2
    out = Path(arguments[0])
    part = out.with_name(out.name + ".part")
    part.write_text(document_of(arguments[1], arguments[2], [Path(name) for name in arguments[3:]]))
    part.replace(out)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
