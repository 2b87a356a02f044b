"""Drives round a ring road between made-up walls, written as keyframe sets with ground truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ROAD_RADIUS, REACH = 60.0, 30.0  # m
LATITUDE, LONGITUDE, METRES_IN_DEGREE = 48.0, 11.0, 111_195.0


def ring_road(points: int, rng: np.random.Generator) -> Array:
    """Points on the ground and on walls of houses on both sides of the road."""
    ground = rng.uniform(-95, 95, (points // 2, 2))
    surfaces = [np.column_stack([ground, np.zeros(len(ground))])]
    houses = 90
    for _ in range(houses):
        angle, side = rng.uniform(0, 2 * math.pi), rng.choice([-1, 1])
        middle = (ROAD_RADIUS + side * rng.uniform(9, 20)) * np.array([math.cos(angle), math.sin(angle)])
        turn, size, height = rng.uniform(0, math.pi), rng.uniform(2, 6, 2), rng.uniform(2, 9)
        share = points // 2 // houses
        along, up, wall = rng.uniform(-1, 1, share), rng.uniform(0, height, share), rng.integers(0, 4, share)
        x = np.where(wall < 2, along, np.where(wall == 2, 1, -1)) * size[0]
        y = np.where(wall < 2, np.where(wall == 0, 1, -1), along) * size[1]
        c, s = math.cos(turn), math.sin(turn)
        surfaces.append(np.column_stack([middle[0] + c * x - s * y, middle[1] + s * x + c * y, up]))
    return np.concatenate(surfaces)


@dataclass(frozen=True)
class Drive:
    first_angle: float  # on the ring, rad
    turns: float
    start: float  # s
    points_per_scan: int


def pose(x: float, y: float, heading: float) -> Array:
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 1.5], [0, 0, 0, 1]])


def write_pcd(path: Path, points: Array) -> None:
    head = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())


def write_drive(folder: Path, drive: Drive, world: Array, rng: np.random.Generator) -> None:
    """The set, and its ground truth in truth.tum. Odometry drifts by a thousandth of a radian a step."""
    (folder / "Scans").mkdir(parents=True)
    step = 3.5  # m
    count = int(drive.turns * 2 * math.pi * ROAD_RADIUS / step)
    odometry, times, fixes, truth = [], [], [], []
    T_odom, last = np.eye(4), None
    for i in range(count):
        angle = drive.first_angle + i * step / ROAD_RADIUS
        T = pose(ROAD_RADIUS * math.cos(angle), ROAD_RADIUS * math.sin(angle), angle + math.pi / 2)
        if last is not None:
            T_odom = T_odom @ np.linalg.inv(last) @ T @ pose(0, 0, 1e-3 * rng.standard_normal()) @ pose(0, 0, 0.5e-3)
            T_odom[2, 3] = 0
        last = T
        near = world[np.hypot(*(world[:, :2] - T[:2, 3]).T) < REACH]
        near = near[rng.permutation(len(near))[: drive.points_per_scan]]
        seen = (near - T[:3, 3]) @ T[:3, :3] + 0.01 * rng.standard_normal(near.shape)
        write_pcd(folder / "Scans" / f"{i:06d}.pcd", seen)
        time = drive.start + i * 0.5
        x, y = T[:2, 3] + 0.3 * rng.standard_normal(2)
        longitude = LONGITUDE + x / METRES_IN_DEGREE / math.cos(math.radians(LATITUDE))
        odometry.append(" ".join(f"{value:.9g}" for value in T_odom[:3].ravel()))
        times.append(f"{time:.3f}")
        fixes.append(f"{LATITUDE + y / METRES_IN_DEGREE:.9f} {longitude:.9f} 1.5 0.5")
        half = (angle + math.pi / 2) / 2
        truth.append(f"{time:.3f} {T[0, 3]:.6f} {T[1, 3]:.6f} 1.5 0 0 {math.sin(half):.9f} {math.cos(half):.9f}")
    for name, lines in {"odom_poses.txt": odometry, "times.txt": times, "gnss.txt": fixes, "truth.tum": truth}.items():
        (folder / name).write_text("\n".join(lines) + "\n")


def write_drives(folder: Path) -> None:
    """`first` and `second` share the road; `dense` has points for a map of more than 300,000."""
    rng = np.random.default_rng(1)
    world = ring_road(700_000, rng)
    sparse = world[::4]
    write_drive(folder / "first", Drive(0.0, 1.3, 1000.0, 3000), sparse, rng)
    write_drive(folder / "second", Drive(2.0, 0.8, 9000.0, 3000), sparse, rng)
    write_drive(folder / "dense", Drive(0.0, 1.0, 1000.0, 12_000), world, rng)


if __name__ == "__main__":
    import sys

    write_drives(Path(sys.argv[1]))
