"""The worlds that tables are made of: simulated ones by name, and data sets given as folders."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

SIZES = ("small", "medium", "large")
SESSIONS = 5  # of every simulated world
PLATFORMS = {"nclt-hard": "nclt", "mars-hard": "mars", "nclt-like": "nclt", "mars-like": "mars"}


@dataclass(frozen=True)
class World:
    """Sessions through one place.

    `sessions` are what `chainslam odometry` reads, with `{seed}` where a simulated one has its seed.
    """

    name: str
    platform: str  # "nclt": a slow robot; "mars": a car
    sessions: tuple[str, ...]
    seeds: int
    identity: str = ""  # of data that their names do not determine

    def data(self, seed: int) -> tuple[str, ...]:
        return tuple(session.replace("{seed}", str(seed)) for session in self.sessions)


class WorldError(Exception):
    """There is no such world."""


def simulated(name: str, size: str, seeds: int, sessions: int = SESSIONS) -> World:
    data = tuple(f"simulate:{name}/{size}/{i + 1}/{{seed}}" for i in range(sessions))
    return World(f"{name}/{size}", PLATFORMS[name], data, seeds)


NCLT_FILES = ("velodyne_hits.bin", "velodyne_sync", "velodyne_data")  # also within the release's own folders


def platform_of(folder: Path) -> str:
    """NCLT's files are from a slow robot, all others that are read for the tables from cars."""
    return "nclt" if any((folder / name).exists() for name in NCLT_FILES) else "mars"


def is_data(path: Path) -> bool:
    """A file or folder, or DIR/SCENE of nuScenes' layout, in which MARS comes."""
    return path.exists() or any(path.parent.glob("v1.0*"))


def _listing(path: Path) -> str:
    """What changes if the files of a data set are others: names, sizes and times of those right below it."""
    folder = path if path.is_dir() else path.parent
    rows = sorted((file.name, file.stat().st_size, int(file.stat().st_mtime)) for file in folder.iterdir())
    return hashlib.sha256(repr(rows).encode()).hexdigest()[:16]


def recorded(paths: list[Path]) -> World:
    """One world of data sets in folders, in the order in which they are given."""
    for path in paths:
        if not is_data(path):
            raise WorldError(f"{path}: no such folder, and no world of that name; worlds: {', '.join(PLATFORMS)}")
    platforms = {platform_of(path) for path in paths}
    if len(platforms) > 1:
        raise WorldError("sessions of a slow robot (NCLT) and of a car cannot be one world; run them by themselves")
    folders = [path.resolve() for path in paths]
    listings = " ".join(map(_listing, folders))
    return World(folders[0].parent.name + "/" + folders[0].name, platforms.pop(), tuple(map(str, folders)), 1, listings)


def worlds(names: list[str], size: str, seeds: int, sessions: int = SESSIONS) -> list[World]:
    """The worlds that are named; paths are the sessions of one more world."""
    found = [simulated(name, size, seeds, sessions) for name in names if name in PLATFORMS]
    paths = [Path(name) for name in names if name not in PLATFORMS]
    return found + ([recorded(paths)] if paths else [])
