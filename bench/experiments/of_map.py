"""Runs a program that reads a map's trajectories and its recordings.

Usage: python3 -m experiments.of_map PROGRAM MAP OUT THREADS SET...
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from .evaluate import sessions_of


def run(program: Path, folder: Path, out: Path, threads: str, sets: list[Path]) -> None:
    """Writes what the program finds to `out`."""
    words: list[str] = []
    for recording, trajectory, frame in sessions_of(folder, sets):
        words += ["--session", str(recording), str(trajectory), str(frame)]
    subprocess.run([program, *words, "--out", out, "--threads", threads], check=True)


if __name__ == "__main__":
    run(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4], [Path(word) for word in sys.argv[5:]])
