"""Runs the tasks of the tables that were asked for, and writes the tables."""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import tomllib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from . import cost, figures, graph_table, readme, table1, table2, table3, table4
from .plan import GRAPH_SOURCES, GROWTH_SESSIONS, TIMED_SCANS, Plan, Programs, Run
from .results import Result, back_end, errors, load, number, options_hash, recording_figures, resources, stage
from .rows import MAIN_ROWS, OWN_ROW, Row, ablations, chosen
from .table import Column, Compared, WorldNote, document, write_json, write_text
from .tasks import Runner, Task, TaskFailed, content_digest, in_order, locked, say
from .worlds import World, worlds

GOAL_MISSED = 5  # exit code of a run that has saved its map and missed a goal
GROWTH_ROWS = ("unchained", "chained", "best")


def preset_settings(program: Path, preset: str, platform: str) -> dict[str, str]:
    """All settings of a preset, as the program prints them."""
    words = [str(program), "config", "--print", "--set", f"preset={preset}", "--set", f"platform={platform}"]
    printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    flat: dict[str, str] = {}
    for section, keys in tomllib.loads(printed).items():
        for key, value in keys.items() if isinstance(keys, dict) else ():
            flat[f"{section}.{key}"] = str(value).lower() if isinstance(value, bool) else str(value)
    return flat


class Maker:
    """One call of run.sh."""

    def __init__(self, arguments: argparse.Namespace, jobs: int) -> None:
        self.arguments = arguments
        self.out: Path = arguments.out.resolve()
        self.programs = Programs(
            arguments.program, arguments.lamm, arguments.graph_seeds, arguments.street_registration,
            arguments.viewpoints, arguments.recorder and arguments.recorder.resolve(),
            arguments.published and arguments.published.resolve(),
        )
        self.plan = Plan(self.programs)
        self.runner = Runner(self.out / "tasks", jobs, say, (0, GOAL_MISSED), self.programs.names())
        data = os.environ.get("CHAINSLAM_UNPACKED_DATA")
        self.worlds = worlds(arguments.worlds, arguments.size, arguments.seeds, arguments.sessions,
                             Path(data) if data else None)
        presets = {
            platform: (
                preset_settings(arguments.program, "best", platform),
                preset_settings(arguments.program, "paper", platform),
            )
            for platform in ("nclt", "mars")
        }
        rows = chosen(arguments.rows, ablations(presets))
        self.rows = [row for row in rows if row.program != "lamm" or self.programs.lamm]
        for row in rows:
            if row not in self.rows:
                say("skipped", f"row {row.name}: the program lamm is not built")
        self.failed: dict[str, str] = {}
        self.asked: dict[str, Task] = {}  # by their folders

    def make(self) -> int:
        with locked(self.out) as self.runner.lock:
            made = {"1": self.table1, "graph": self.graph, "2": self.table2, "3": self.table3, "4": self.table4, "5": self.table5}
            for name in self.arguments.tables:
                made[name]()
            self.cost()
        if self.failed:
            say("failed", f"{len(self.failed)} tasks; the tables are without what they would have shown")
            return 1
        say("passed", f"tables {', '.join(self.arguments.tables)} in {self.out}")
        return 0

    def seeds(self, world: World) -> range:
        return range(1, world.seeds + 1)

    def run(self, tasks: Sequence[Task]) -> None:
        self.asked |= {task.folder: task for task in in_order(tasks)}
        self.failed |= self.runner.run(tasks)

    def done(self, runs: Sequence[Run]) -> list[Run]:
        return [run for run in runs if self.runner.is_done(run.task)]

    def note(self, world: World) -> WorldNote:
        """What the recordings of FAST-LIO2 say of a world."""
        recordings = [
            [self.runner.path(self.plan.odometry(world, seed, i, "fast_lio2")) / "set" for i in range(len(world.sessions))]
            for seed in self.seeds(world)
        ]
        complete = [folders for folders in recordings if all(folder.is_dir() for folder in folders)]
        if not complete:
            return WorldNote(world.name, "", len(world.sessions), world.seeds)
        found = [recording_figures(folders) for folders in complete]
        mean = {key: sum(one[key] for one in found) / len(found) for key in found[0]}
        options = self.identity(world) if world.recipes else options_hash(complete[0][0])
        return WorldNote(world.name, options, len(world.sessions), world.seeds, **mean)

    def identity(self, world: World) -> str:
        """Of drives that are simulated on recorded ones, by all that is kept of them."""
        digest = hashlib.sha256()
        for session in range(len(world.sessions)):
            folder = self.runner.path(self.plan.drive(world, 1, session)) / "drive"
            for file in sorted((folder / "simulation").iterdir()):
                digest.update(file.read_bytes())
        return digest.hexdigest()[:16]

    def about(self) -> dict[str, Any]:
        return {
            "size": self.arguments.size,
            "program": content_digest(self.programs.chainslam),
            "recorder": self.programs.identity("recorder"),
            "published": self.programs.identity("published"),
            "rows": [asdict(row) for row in self.rows],
        }

    def table1(self) -> None:
        say("table 1", f"{len(self.worlds)} worlds, {len(self.rows)} rows")
        runs = [self.plan.map(w, seed, row) for w in self.worlds for seed in self.seeds(w) for row in self.rows]
        self.run([run.task for run in runs])
        runs = self.done(runs)
        results = [
            Result(run.world.name, run.row.name, run.seed, errors(self.runner.path(run.task) / "map")) for run in runs
        ]
        notes = [self.note(world) for world in self.worlds]
        compared = table1.compare(results, notes)
        self.write("1", table1.markdown(results, notes, compared, self.definitions()), notes, results, compared)
        pictures = self.out / "figures"
        pictures.mkdir(exist_ok=True)
        for world in self.worlds:
            if world.seeds > 1:
                figures.box_plots(results, world.name, pictures)
            shown = [run for run in runs if run.world == world and run.seed == 1]
            sets = {run.row.name: [self.runner.path(task) / "set" for task in run.task.after] for run in shown}
            maps = {run.row.name: self.runner.path(run.task) / "map" for run in shown}
            figures.paths(maps, sets, world.name, pictures)
            figures.errors_over_distance(maps, sets, world.name, pictures)

    def table2(self) -> None:
        say("table 2", "streets, from the maps of table 1")
        runs = [self.plan.streets(w, seed, row) for w in self.worlds for seed in self.seeds(w) for row in self.rows]
        self.run([run.task for run in runs])
        results: list[Result] = []
        floors: dict[str, tuple[int, float]] = {}
        for run in self.done(runs):
            written = load(self.runner.path(run.task) / "streets.json")
            results.append(Result(run.world.name, run.row.name, run.seed, table2.figures(written)))
            floors.setdefault(run.world.name, (len(written["streets"]), table2.true_thickness(written)))
        notes = [self.note(world) for world in self.worlds]
        self.write("2", table2.markdown(results, notes, floors), notes, results, {})

    def table3(self) -> None:
        say("table 3", "views, from the maps of table 1")
        runs = [self.plan.viewpoints(w, seed, row) for w in self.worlds for seed in self.seeds(w) for row in self.rows]
        self.run([run.task for run in runs])
        results: list[Result] = []
        shown: dict[str, dict[str, Any]] = {}  # of the first seed of each world, by row
        for run in self.done(runs):
            written = load(self.runner.path(run.task) / "viewpoints.json")
            results.append(Result(run.world.name, run.row.name, run.seed, table3.figures(written)))
            if run.seed == 1 and "shown" in written:
                shown.setdefault(run.world.name, {})[run.row.name] = written["shown"]
        notes = [self.note(world) for world in self.worlds]
        compared = table3.compare(results, notes)
        self.write("3", table3.markdown(results, notes, compared), notes, results, compared)
        pictures = self.out / "figures"
        pictures.mkdir(exist_ok=True)
        for world, views in shown.items():
            figures.panoramas(views, world, pictures)

    def graph(self) -> None:
        say("graph", "worlds drawn from what the runs of chained and best have measured")
        known = {row.name: row for row in MAIN_ROWS}
        rows = [row for row in self.rows if row.name in GRAPH_SOURCES]
        runs = [self.plan.graph_seeds(w, row, known[GRAPH_SOURCES[row.name]]) for w in self.worlds for row in rows]
        self.run([run.task for run in runs])
        results: list[Result] = []
        statistics: dict[str, dict[str, Any]] = {}
        for run in self.done(runs):
            drawn = load(self.runner.path(run.task) / "graph.json")
            results += graph_table.results_of(drawn, run.world.name, run.row.name)
            statistics.setdefault(run.world.name, {})[GRAPH_SOURCES[run.row.name]] = drawn["statistics"]
        notes = [self.note(world) for world in self.worlds]
        compared = graph_table.compare(results, notes)
        self.write("graph", graph_table.markdown(results, notes, compared, statistics), notes, results, compared)

    def table4(self) -> None:
        say("table 4", "times: the last session of each row by itself")
        world_rows = [(w, row) for w in self.worlds for row in self.rows if not row.is_front_end]
        last: list[Run] = []
        fronts: dict[tuple[str, str], Task] = {}
        for world, row in world_rows:
            fronts[world.name, row.odometry] = self.plan.timed_odometry(world, 1, row.odometry)
            if row.program == "lamm":
                last.append(self.plan.map(world, 1, row))
            else:
                growth = "5" in self.arguments.tables and row.name in GROWTH_ROWS
                last.append(self.plan.sequence(world, 1, row, growth)[-1])
        self.run([*(run.task for run in last), *fronts.values()])
        results = []
        for run in self.done(last):
            front = fronts[run.world.name, run.row.odometry]
            recorded = run.task.after if run.row.program == "lamm" else run.task.after[:1]
            found = self.efficiency(run, [self.runner.path(task) / "set" for task in recorded])
            if self.runner.is_done(front):
                summary = load(self.runner.path(front) / "set/summary.json")
                found |= stage(summary, "odometry", "front")
                found["fps"] = 1000 / (found["front_mean_ms"] + found["scan_back_ms"])
            results.append(Result(run.world.name, run.row.name, 1, found))
        text = table4.INTRODUCTION.format(scans=TIMED_SCANS)
        self.write_plain("4", table4.TITLE, text, table4.COLUMNS, results)

    def table5(self) -> None:
        say("table 5", "times: one task at a time")
        chains = [
            self.plan.sequence(world, 1, row, True)
            for world in self.worlds
            for row in self.rows
            if row.name in GROWTH_ROWS
        ]
        known = {row.name: row for row in MAIN_ROWS}
        drawn = [
            self.plan.graph_growth(world, row, known[GRAPH_SOURCES[row.name]])
            for world in self.worlds
            for row in self.rows
            if row.name in GROWTH_ROWS
        ]
        self.run([*(run.task for runs in chains for run in runs), *(run.task for run in drawn)])
        results: list[Result] = []
        for runs in chains:
            for i, run in enumerate(self.done(runs)):
                found = self.efficiency(run, [self.runner.path(run.task.after[0]) / "set"])
                results.append(Result(run.world.name, f"{run.row.name}, session {i + 1}", 1, found))
        on_graphs: list[Result] = []
        for run in self.done(drawn):
            written = load(self.runner.path(run.task) / "graph.json")
            on_graphs += table4.drawn_results(written, run.world.name, run.row.name)
        notes = [self.note(world) for world in self.worlds]
        text = table4.markdown(table4.GROWTH_TITLE, table4.GROWTH_INTRODUCTION, table4.GROWTH_COLUMNS, results, notes)
        introduction = table4.DRAWN_INTRODUCTION.format(sessions=GROWTH_SESSIONS)
        text += "\n" + table4.markdown(table4.DRAWN_TITLE, introduction, table4.DRAWN_COLUMNS, on_graphs, notes)
        for result in on_graphs:
            results.append(Result(result.world, f"drawn: {result.row}", result.seed, result.figures))
        self.write("5", text, notes, results, {})

    def cost(self) -> None:
        done = [(task, self.runner.path(task)) for task in self.asked.values() if self.runner.is_done(task)]
        entries = cost.costs(done)
        write_json(self.out / "cost.json", {"size": self.arguments.size, "costs": entries})
        self.write_markdown("cost", cost.markdown(entries))

    def efficiency(self, run: Run, recordings: Sequence[Path]) -> dict[str, float]:
        folder = self.runner.path(run.task)
        summary = load(folder / "map/summary.json")
        scans = sum(number(load(recording / "summary.json"), "scans") for recording in recordings)
        keyframes = {"keyframes": number(summary, "keyframes")}
        return back_end(summary, scans) | resources(folder) | keyframes

    def definitions(self) -> str:
        lines = [f"- `{row.name}`: {row.definition}" for row in self.rows]
        shared = "Rows; all but `best-own` read" if OWN_ROW in self.rows else "Rows; all read"
        return f"\n{shared} the same recording of FAST-LIO2's odometry:\n" + "\n".join(lines) + "\n"

    def write_plain(
        self, name: str, title: str, introduction: str, columns: Sequence[Column], results: Sequence[Result]
    ) -> None:
        notes = [self.note(world) for world in self.worlds]
        self.write(name, table4.markdown(title, introduction, columns, results, notes), notes, results, {})

    def write(
        self,
        name: str,
        text: str,
        notes: Sequence[WorldNote],
        results: Sequence[Result],
        compared: Compared,
    ) -> None:
        file = readme.file_name(name)
        write_json(self.out / f"{file}.json", document(name, self.about(), notes, results, compared))
        self.write_markdown(file, text)

    def write_markdown(self, file: str, text: str) -> None:
        write_text(self.out / f"{file}.md", text)
        say("written", str(self.out / f"{file}.md"))
        if self.arguments.readme:
            readme.insert(readme.README, file, self.arguments.size, text)
