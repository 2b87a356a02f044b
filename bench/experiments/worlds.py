"""The worlds that tables are made of: simulated ones by name, and data sets given as folders."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

SIZES = ("small", "medium", "large")
SESSIONS = 5  # of every simulated world
PLATFORMS = {"nclt-hard": "nclt", "mars-hard": "mars", "nclt-like": "nclt", "mars-like": "mars"}
ROUTES = ("nclt-routes", "kitti-routes")  # simulated scans on recorded drives, where the data are at hand
NAMES = (*PLATFORMS, *ROUTES)
ROUTE_SCANS = {"small": 900, "medium": 9000, "large": 0}  # 0: the whole drive


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
    # Words of `chainslam simulate` that make each session first; `sessions` are then their names.
    recipes: tuple[tuple[str, ...], ...] = ()
    max_scans: int = 0  # of each session; 0: all

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
            raise WorldError(f"{path}: no such folder, and no world of that name; worlds: {', '.join(NAMES)}")
    platforms = {platform_of(path) for path in paths}
    if len(platforms) > 1:
        raise WorldError("sessions of a slow robot (NCLT) and of a car cannot be one world; run them by themselves")
    folders = [path.resolve() for path in paths]
    listings = " ".join(map(_listing, folders))
    return World(folders[0].parent.name + "/" + folders[0].name, platforms.pop(), tuple(map(str, folders)), 1, listings)


def _files(paths: list[Path]) -> str:
    """Identity of a few small files: a hash of their bytes."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def _checked(data: Path | None, names: list[str], world: str) -> list[Path]:
    """Files of the real data; the unpacked ones, as CHAINSLAM_DATA's script leaves them."""
    if data is None:
        raise WorldError(f"{world} needs real trajectories: set CHAINSLAM_DATA to the folder of real data")
    missing = [name for name in names if not (data / name).is_file()]
    if missing:
        raise WorldError(f"{world} needs {', '.join(missing)} in the folder of real data")
    return [data / name for name in names]


NCLT_DAYS = ("2012-01-08", "2012-04-29", "2012-08-04")
NCLT_SENSORS = ("--gnss", "--lidar", "HDL-32E", "--columns", "540")


def nclt_routes(data: Path | None, size: str, seeds: int) -> World:
    """Three real drives through one world that is built along all of them; everything measured is simulated."""
    files = _checked(data, [f"trajectories/nclt/{day}/groundtruth.csv" for day in NCLT_DAYS], "nclt-routes")
    recipes = tuple(
        ("--trajectory", str(file), *(word for other in files if other != file for word in ("--also", str(other))),
         *NCLT_SENSORS)
        for file in files
    )
    return World(f"nclt-routes/{size}", "nclt", NCLT_DAYS, seeds, _files(files), recipes, ROUTE_SCANS[size])


KITTI_RATES = {"00": 1 / 0.10365, "05": 1 / 0.1044, "07": 1 / 0.1040}  # Hz, of the raw recordings' time stamps


def kitti_routes(data: Path | None, size: str, seeds: int) -> list[World]:
    """Real drives that revisit their streets, with the IMU data that were measured on them: a world each."""
    found = []
    for drive, rate in KITTI_RATES.items():
        names = [f"kitti_imu/{drive}_{name}" for name in ("truth_camera.txt", "imu.csv")] + ["kitti_imu/filled.txt"]
        truth, imu, filled = _checked(data, names, "kitti-routes")
        recipe = ("--trajectory", str(truth), "--rate", f"{rate:.6f}", "--camera-lidar", "kitti", "--body-lidar", "kitti",
                  "--imu", str(imu), "--skip", str(filled), "--gnss")
        identity = _files([truth, imu, filled])
        found.append(World(f"kitti-routes/{drive}/{size}", "mars", (drive,), seeds, identity, (recipe,), ROUTE_SCANS[size]))
    return found


def worlds(
    names: list[str], size: str, seeds: int, sessions: int = SESSIONS, data: Path | None = None
) -> list[World]:
    """The worlds that are named; paths are the sessions of one more world.

    @param data  folder of unpacked real data, where routes come from.
    """
    found = []
    for name in names:
        if name in PLATFORMS:
            found.append(simulated(name, size, seeds, sessions))
        elif name == "nclt-routes":
            found.append(nclt_routes(data, size, seeds))
        elif name == "kitti-routes":
            found += kitti_routes(data, size, seeds)
    paths = [Path(name) for name in names if name not in NAMES]
    return found + ([recorded(paths)] if paths else [])
