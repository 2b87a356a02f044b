"""Which tasks a table is made of."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path

from . import evaluate
from .rows import OWN, Row
from .tasks import OUT, THREADS, Task, TaskFailed, content_digest
from .worlds import World

# A table shows what was lost; it is no reason to stop.
ACCEPT_LOSSES = ("goals.max_lost_share=1", "goals.max_map_restarts=-1")
TIMED_SCANS = 3000  # of the front end: 5 min of driving
GRAPH_SEEDS = 20
GROWTH_SESSIONS = 27
UNUSED = ("map/*.ply", "map/report.html", "map/map.png")  # of a map's files


# Rows on drawn graphs, and the row with scans whose attempts they are drawn from.
GRAPH_SOURCES = {"unchained": "chained", "chained": "chained", "best-unchained": "best", "best": "best"}


@dataclass(frozen=True)
class Programs:
    """What tasks run. `lamm` is None where it is not built."""

    chainslam: Path
    lamm: Path | None = None
    graph_seeds: Path | None = None
    street_registration: Path | None = None
    viewpoints: Path | None = None
    recorder: Path | None = None  # the build of chainslam that records odometry; None: `chainslam`
    published: Path | None = None  # the build that maps rows of the published system; None: `chainslam`

    def path(self, program: str) -> Path:
        path: Path | None = getattr(self, program)
        if program in ("recorder", "published"):
            path = path or self.chainslam
        if path is None:
            raise TaskFailed(f"{program} is not built; run bench/experiments/run.sh, which builds it")
        return path

    def identity(self, program: str) -> str:
        return content_digest(self.path(program))

    def names(self) -> dict[str, str]:
        """What stands for the programs in the commands of tasks."""
        found = {"python": sys.executable}
        for field in fields(self):
            if path := getattr(self, field.name):
                found[field.name] = str(path)
        found["recorder"] = str(self.path("recorder"))
        return found


@dataclass(frozen=True)
class Run:
    """A task with what it stands for."""

    world: World
    seed: int
    row: Row
    task: Task


def settings(words: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(word for setting in words for word in ("--set", setting))


class Plan:
    """Makes the tasks of one set of programs; equal tasks are one."""

    def __init__(self, programs: Programs) -> None:
        self.programs = programs

    def odometry(self, world: World, seed: int, session: int, kind: str) -> Task:
        """Records one session: as the paper's front end does, or by the default one."""
        preset = () if kind == OWN else ("preset=paper",)
        return self._odometry(world, seed, session, preset, f"{kind}", alone=False)

    def timed_odometry(self, world: World, seed: int, kind: str) -> Task:
        """The beginning of the last session with both cores, for its times."""
        preset = () if kind == OWN else ("preset=paper",)
        session = len(world.sessions) - 1
        return self._odometry(world, seed, session, preset, f"{kind}-timed", alone=True)

    def _odometry(
        self, world: World, seed: int, session: int, preset: tuple[str, ...], label: str, alone: bool
    ) -> Task:
        after = (self.drive(world, seed, session),) if world.recipes else ()
        data = "simulate:{0}/drive" if after else world.data(seed)[session]
        program = "chainslam" if alone else "recorder"
        command = (
            (f"{{{program}}}", "odometry", data, "--out", f"{OUT}/set", "--threads", THREADS)
            + settings(preset + (f"platform={world.platform}",) + ACCEPT_LOSSES)
        )
        most = min(filter(None, (world.max_scans, TIMED_SCANS if alone else 0)), default=0)
        if most:
            command += ("--max-scans", str(most))
        name = f"{world.name}/seed{seed}/odometry-{label}-{session + 1}"
        depends = (self.programs.identity(program), world.identity)
        return Task(name, (command,), after, depends, alone, ("set/Scans/*",) if alone else ())

    def drive(self, world: World, seed: int, session: int) -> Task:
        """What scans are simulated from, on a recorded drive."""
        words = (*world.recipes[session], "--no-scans", "--seed", str(seed), "--out", f"{OUT}/drive")
        depends = (self.programs.identity("recorder"), world.identity)
        name = f"{world.name}/seed{seed}/drive-{session + 1}"
        return Task(name, (("{recorder}", "simulate", *words),), depends=depends)

    def sets(self, world: World, seed: int, row: Row) -> tuple[Task, ...]:
        return tuple(self.odometry(world, seed, i, row.odometry) for i in range(len(world.sessions)))

    def map(self, world: World, seed: int, row: Row) -> Run:
        """All sessions in one run, and its errors. Systems that load no map run by themselves: table 4 has their times."""
        sets = self.sets(world, seed, row)
        folders = [f"{{{i}}}/set" for i in range(len(sets))]
        chainslam = "published" if row.is_published else "chainslam"
        program = chainslam if row.program == "chainslam" else row.program
        timed = row.program == "lamm"
        task = Task(
            f"{world.name}/seed{seed}/{row.name}",
            (self._map_command(world, row, folders, ()), self._evaluate(folders)),
            after=sets,
            depends=(self.programs.identity(program), self.programs.identity(chainslam), _recipe()),
            alone=timed,
            drop=UNUSED if timed or row.name in GRAPH_SOURCES.values() else (*UNUSED, "map/map.cslam"),
            names=(("chainslam", str(self.programs.path(chainslam))),),
        )
        return Run(world, seed, row, task)

    def streets(self, world: World, seed: int, row: Row) -> Run:
        """Clouds of streets by the poses of a map, against those by true ones."""
        return self._of_map(world, seed, row, "street_registration", "streets")

    def viewpoints(self, world: World, seed: int, row: Row) -> Run:
        """Views rendered from a map where keyframes were held out, against their scans."""
        return self._of_map(world, seed, row, "viewpoints", "viewpoints")

    def _of_map(self, world: World, seed: int, row: Row, program: str, label: str) -> Run:
        """A program that reads a map's trajectories and the recordings, and writes one JSON file."""
        mapped = self.map(world, seed, row).task
        sets = self.sets(world, seed, row)
        command: tuple[str, ...] = ("{python}", "-m", f"{__package__}.of_map", f"{{{program}}}")
        command += ("{0}/map", f"{OUT}/{label}.json", THREADS)
        command += tuple(f"{{{i + 1}}}/set" for i in range(len(sets)))
        depends = (self.programs.identity(program),)
        return Run(world, seed, row, Task(f"{world.name}/seed{seed}/{label}-{row.name}", (command,), (mapped, *sets), depends))

    def graph_seeds(self, world: World, row: Row, source: Row) -> Run:
        """Worlds that are drawn from what the first run of `source` has measured, mapped as `row` does."""
        return self._drawn(world, row, source, f"graph-{row.name}", ("--seeds", str(GRAPH_SEEDS)), alone=False)

    def graph_growth(self, world: World, row: Row, source: Row) -> Run:
        """Many sessions of one such world, timed."""
        words = ("--seeds", "0", "--growth", str(GROWTH_SESSIONS))
        return self._drawn(world, row, source, f"growth-{row.name}", words, alone=True)

    def _drawn(
        self, world: World, row: Row, source: Row, label: str, words: tuple[str, ...], alone: bool
    ) -> Run:
        measured = self.map(world, 1, source).task
        sets = self.sets(world, 1, source)
        command: tuple[str, ...] = ("{graph_seeds}", "{0}/map")
        command += tuple(f"{{{i + 1}}}/set" for i in range(len(sets)))
        extra = row.settings[len(source.settings) :]  # of a row that does what the source does, and something else
        command += ("--out", f"{OUT}/graph.json", *words, *settings(extra))
        depends = (self.programs.identity("graph_seeds"),)
        return Run(world, 1, row, Task(f"{world.name}/{label}", (command,), (measured, *sets), depends, alone))

    def sequence(self, world: World, seed: int, row: Row, all_timed: bool) -> list[Run]:
        """One run for each session, which loads the map of those before.

        @param all_timed  each runs by itself, for its times; else only the last one.
        """
        sets = self.sets(world, seed, row)
        runs: list[Run] = []
        for i, recording in enumerate(sets):
            before = tuple(run.task for run in runs[-1:])
            load = ("--load", "{1}/map/map.cslam") if before else ()
            task = Task(
                f"{world.name}/seed{seed}/{row.name}-session{i + 1}",
                (self._map_command(world, row, ["{0}/set"], load),),
                after=(recording, *before),
                depends=(self.programs.identity(row.program),),
                alone=all_timed or i + 1 == len(sets),
                drop=UNUSED,
            )
            runs.append(Run(world, seed, row, task))
        return runs

    def _map_command(self, world: World, row: Row, sets: list[str], load: tuple[str, ...]) -> tuple[str, ...]:
        if row.program == "lamm":
            return ("{lamm}", *sets, "--out", f"{OUT}/map", "--threads", THREADS, *row.settings)
        words = row.settings_on(world.platform)
        chosen = words[:1] if words and words[0].startswith("preset=") else ()
        rest = words[len(chosen) :]
        return (
            ("{chainslam}", "map", *sets, *load, "--out", f"{OUT}/map", "--threads", THREADS)
            + settings(chosen + (f"platform={world.platform}",) + rest + ACCEPT_LOSSES)
        )

    def _evaluate(self, sets: list[str]) -> tuple[str, ...]:
        module = f"{__package__}.evaluate"
        return ("{python}", "-m", module, "{chainslam}", f"{OUT}/map", *sets)


def _recipe() -> str:
    return content_digest(Path(evaluate.__file__))
