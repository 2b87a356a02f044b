"""A table from files whose figures are known, rows, worlds, and the README's markers."""

import contextlib
import io
import json
import math
import tempfile
import unittest
from pathlib import Path
from typing import Any

from experiments import cost, figures, graph_table, table1, table2, table3
from experiments.__main__ import TABLES, checked
from experiments.evaluate import file_tags, frames, trajectories
from experiments.markdown import figure, interval, spread
from experiments.plan import GRAPH_SOURCES, Plan, Programs
from experiments.readme import MarkerError, with_result
from experiments.results import Result, back_end, errors, options_hash, resources, stage
from experiments.rows import MAIN_ROWS, OWN_ROW, RowError, ablations, chosen, differing, subject_of
from experiments.table import WorldNote, document, plain, values
from experiments.tasks import Task, TaskFailed
from experiments.worlds import WorldError, simulated, worlds


def write(path: Path, value: object) -> None:
    path.write_text(json.dumps(value))


def ape(count: int, metres: float, degrees: float) -> dict[str, object]:
    return {"ape": {"count": count, "translation": {"rmse": metres}, "rotation_deg": {"rmse": degrees}}}


def session(name: str, frame: int, metres: float) -> dict[str, object]:
    rmse = {"translation": {"rmse": metres}, "rotation_deg": {"rmse": 2 * metres}}
    return {"name": name, "frame": frame, "loaded": False, "errors": {"optimized": {"ape": rmse}}}


class Scratch(unittest.TestCase):
    def setUp(self) -> None:
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.root = Path(scratch.name)


class FiguresOfARun(Scratch):
    def two_frames(self) -> Path:
        sessions = [session("a", 0, 1.0), session("b", 1, 3.0), session("c", 0, 2.0)]
        whole = {"optimized": {"ape": {"translation": {"rmse": 2.5}, "rotation_deg": {"rmse": 5.0}}}}
        whole["inter_session"] = {"rpe": {"translation": {"rmse": 0.5, "median": 0.4}, "rotation_deg": {"rmse": 1.0}}}
        write(self.root / "summary.json", {"sessions": sessions, "errors": whole,
                                           "closures": {"direct": 7, "chained": 2, "merge": 1}})
        write(self.root / "errors.0.xy.json", ape(300, 1.0, 2.0))
        write(self.root / "errors.1.xy.json", ape(100, 3.0, 6.0))
        return self.root

    def test_errors_are_those_that_the_program_wrote(self) -> None:
        found = errors(self.two_frames())
        self.assertEqual((found["ape_3d_m"], found["ape_3d_deg"], found["between_m"]), (2.5, 5.0, 0.5))
        self.assertEqual((found["direct"], found["chained"], found["merges"], found["frames"]), (7, 2, 1, 2))
        self.assertEqual((found["session_3d_m"], found["session_3d_deg"]), (2.0, 4.0))

    def test_frames_are_pooled_by_their_poses(self) -> None:
        self.assertAlmostEqual(errors(self.two_frames())["ape_2d_m"], math.sqrt((300 * 1 + 100 * 9) / 400))

    def test_a_run_without_truth_has_no_errors(self) -> None:
        write(self.root / "summary.json", {"sessions": [{"name": "a", "frame": 0}], "errors": {}})
        found = errors(self.root)
        self.assertTrue(all(math.isnan(found[key]) for key in ("ape_2d_m", "ape_3d_m", "between_m", "session_3d_m")))

    def test_sessions_are_told_apart_as_the_program_names_their_files(self) -> None:
        self.assertEqual(file_tags(["only"]), [""])
        self.assertEqual(file_tags(["a b", "a_b", "", "a_b"]), [".a_b", ".a_b-2", ".session", ".a_b-3"])
        loaded = {"name": "old", "frame": 0, "loaded": True}
        summary = {"sessions": [loaded, session("x", 0, 1), session("y", 2, 1)]}
        self.assertEqual([p.name for p in trajectories(self.root, summary)], ["trajectory.x.tum", "trajectory.y.tum"])
        self.assertEqual(frames(summary), [[0], [1]])

    def test_times_are_of_each_keyframe_and_each_scan(self) -> None:
        stages = {"back end": {"total_s": 6.0, "count": 30}, "odometry": {"total_s": 2.0, "count": 100, "p50_ms": 19}}
        summary = {"stages": stages, "back_end": {"keyframes": 30, "alignments": 5, "per_keyframe": {"p99_ms": 900}}}
        found = back_end(summary, 400)
        self.assertEqual((found["keyframe_mean_ms"], found["scan_back_ms"], found["keyframe_p99_ms"]), (200, 15, 900))
        self.assertEqual(stage(summary, "odometry", "front")["front_mean_ms"], 20)
        lamm = {"stages": {"describe": {"total_s": 1.0}, "search": {"total_s": 2.0}, "optimize": {"total_s": 3.0}},
                "keyframes": 60, "back_end": {"keyframes": 0, "per_keyframe": {"p99_ms": 0}}}
        self.assertEqual(back_end(lamm, 600)["keyframe_mean_ms"], 100)
        self.assertTrue(math.isnan(back_end(lamm, 600)["keyframe_p99_ms"]))

    def test_the_worlds_hash_is_read_from_the_recording(self) -> None:
        write(self.root / "summary.json", {"notes": ["simulated", "options of the simulation: 0123abcd"]})
        self.assertEqual(options_hash(self.root), "0123abcd")


class WholeTable(Scratch):
    def results(self) -> list[Result]:
        of = {"unchained": [2.0, 4.0, 3.0], "chained": [1.0, 3.0, math.nan]}
        return [Result("w", row, seed + 1, {"ape_3d_m": value, "direct": 12})
                for row, of_row in of.items() for seed, value in enumerate(of_row)]

    def test_a_tiny_table(self) -> None:
        worlds_ = [WorldNote("w", "f00d", 5, 3, 1234.0, 2000, 0.001)]
        compared = table1.compare(self.results(), worlds_)
        text = table1.markdown(self.results(), worlds_, compared)
        self.assertIn("simulated, options `f00d`; 5 sessions, 3 seeds", text)
        self.assertRegex(text, r"\| unchained +\|.*\| 3 \(2\.\.4\) ")
        self.assertRegex(text, r"\| chained +\|.*\| 2 \(1\.\.3; 2 of 3\) ")
        line = next(line for line in text.splitlines() if line.startswith("| chained - unchained") and "3-D m" in line)
        self.assertEqual([cell.strip() for cell in line.split("|")][3:7], ["2", "2 / 0", "0.500", "-1"])
        defined = table1.markdown(self.results(), worlds_, compared, "\nRows:\n")  # of all worlds: before the first
        self.assertEqual(defined.replace("\nRows:\n", ""), text)
        self.assertLess(defined.index("\nRows:\n"), defined.index("\n## w\n"))

    def test_a_seed_that_failed_in_one_row_leaves_the_others_paired(self) -> None:
        results = [r for r in self.results() if (r.row, r.seed) != ("chained", 1)]
        self.assertTrue(math.isnan(values(results, "w", "chained", "ape_3d_m")[0]))
        worlds_ = [WorldNote("w", "f00d", 5, 3)]
        found = {(a, b, key): p for a, b, key, p in table1.compare(results, worlds_)["w"]}
        self.assertEqual(found["chained", "unchained", "ape_3d_m"].mean, 3.0 - 4.0)
        self.assertIn("| 3 (3..3; 1 of 3) ", table1.markdown(results, worlds_, {}))

    def test_the_document_has_every_figure_and_no_nan(self) -> None:
        worlds_ = [WorldNote("w", "f00d", 5, 3)]
        text = json.dumps(plain(document("1", {"size": "small"}, worlds_, self.results(), {})), allow_nan=False)
        read = json.loads(text)
        self.assertEqual(len(read["results"]), 6)
        self.assertIsNone(read["results"][5]["figures"]["ape_3d_m"])
        self.assertEqual(read["worlds"][0]["options"], "f00d")

    def test_drawn_graphs_are_compared_seed_by_seed(self) -> None:
        def drawn(metres: float) -> dict[str, object]:
            return {"seeds": [{"seed": s, "ape_3d_m": metres + s, "between_m": None} for s in range(1, 21)]}

        results = graph_table.results_of(drawn(1.0), "w", "chained") + graph_table.results_of(drawn(1.5), "w", "unchained")
        worlds_ = [WorldNote("w", "", 3, 1)]
        counts = {"tried": 200, "converged": 100, "false": 3, "rms_m": 0.1, "rms_deg": None}
        measured = {"w": {"chained": {"closures": counts, "merges": counts, "step_rms_m": 0.02}}}
        text = graph_table.markdown(results, worlds_, graph_table.compare(results, worlds_), measured)
        self.assertRegex(text, r"chained - unchained +\| 3-D m +\| 20 +\| 20 / 0 +\| 0\.00000191 ")
        self.assertRegex(text, r"chained +\| closures +\| 200 +\| 50 +\| 3 +\| 0\.100 +\| - ")

    def test_views_are_those_that_the_program_wrote_and_one_is_drawn_for_each_row(self) -> None:
        written = {"views": 12, "psnr_db": 21.5, "loss": 0.05, "uncovered": 0.125, "intensity_psnr_db": 16.25,
                   "intensity_loss": 0.25}
        found = table3.figures(written)
        self.assertEqual(found, written)
        note = WorldNote("w", "", 2, 2)
        results = [Result("w", row, seed, found) for row in ("best", "chained") for seed in (1, 2)]
        text = table3.markdown(results, [note], table3.compare(results, [note]))

        def cells(line: str) -> list[str]:
            return [cell.strip() for cell in line.strip("|").split("|")]

        head = next(cells(line) for line in text.splitlines() if "intensity PSNR dB" in line)
        row = next(cells(line) for line in text.splitlines() if line.startswith("| best "))
        shown = {name: cell.split(" ")[0] for name, cell in zip(head, row, strict=True)}
        self.assertEqual(shown, {"": "best", "range PSNR dB": "21.50", "range loss": "0.0500",
                                 "intensity PSNR dB": "16.25", "intensity loss": "0.250", "uncovered %": "12", "views": "12"})
        self.assertRegex(text, r"\| best - chained +\| intensity loss +\| 2 ")

    def test_maps_without_intensities_have_views_of_ranges_alone(self) -> None:
        found = table3.figures({"views": 12, "psnr_db": 21.5, "loss": 0.05, "uncovered": 0.125})
        text = table3.markdown([Result("w", "best", 1, found)], [WorldNote("w", "", 2, 1)], {})
        self.assertRegex(text.splitlines()[-1], r"^\| best \| 21\.50 +\| 0\.0500 +\| - +\| - +\| 12 +\| 12 +\|$")
        self.assertTrue(math.isnan(table3.figures({"views": 0})["psnr_db"]))

    def test_the_same_view_is_drawn_of_each_map_with_intensities_if_all_have_them(self) -> None:
        view = {"session": 2, "time_ns": 1, "rows": 2, "columns": 3, "scan": [-1, 0, 255, 1, 2, 3], "rendered": [5] * 6}
        both = view | {"scan_intensities": [-1, 9, 255, 1, 2, 3], "rendered_intensities": [7] * 6}

        def width(views: dict[str, Any]) -> int:
            figures.panoramas(views, "nclt-hard/small", self.root)
            picture = (self.root / "nclt-hard-small-viewpoints.png").read_bytes()
            return int.from_bytes(picture[16:20], "big")

        ranges_alone = width({"best": view, "chained": both})
        self.assertGreater(width({"best": both, "chained": both}), 1.5 * ranges_alone)

    def test_memory_is_what_the_program_says_of_itself(self) -> None:
        (self.root / "map").mkdir()
        write(self.root / "map/summary.json", {"peak_memory_bytes": 7e7})
        write(self.root / "task.json", {"commands": [{"wall_seconds": 2.0}, {"wall_seconds": 1.0}]})
        found = resources(self.root)
        self.assertEqual((found["peak_memory_bytes"], found["wall_s"]), (7e7, 3.0))
        self.assertTrue(math.isnan(found["map_bytes"]))

    def test_costs_are_added_up_by_world_and_kind(self) -> None:
        tasks = []
        for name, seconds in (("w/small/seed1/odometry-fast_lio2-1", 60.0), ("w/small/seed2/odometry-fast_lio2-2", 180.0),
                              ("w/small/seed1/odometry-fast_lio2-timed-3", 1.0), ("w/small/seed1/best", 6.0),
                              ("w/small/seed1/best-session2", 7.0), ("w/small/graph-best", 8.0),
                              ("w/small/seed1/streets-best", 9.0), ("v/small/seed1/best-session5", 10.0)):
            folder = self.root / name.replace("/", "-")
            folder.mkdir()
            write(folder / "task.json", {"commands": [{"processor_seconds": seconds}, {"processor_seconds": 0.0}]})
            tasks.append((Task(name, ()), folder))
        entries = {(entry["world"], entry["kind"]): entry for entry in cost.costs(tasks)}
        odometry = entries["w/small", "odometry fast_lio2"]
        self.assertEqual((odometry["tasks"], odometry["seconds"], odometry["longest_s"]), (2, 240.0, 180.0))
        self.assertEqual([kind for world, kind in entries if world == "w/small"],
                         ["odometry fast_lio2", "timed odometry", "map best", "timed maps", "drawn graphs", "streets"])
        self.assertIn(("v/small", "timed maps"), entries)
        text = cost.markdown(list(entries.values()))
        self.assertIn("## w/small: 4.52 minutes", text)
        self.assertRegex(text, r"odometry fast_lio2 +\| 2 +\| 4 +\| 3 +\|")

    def test_streets_are_averaged_over_clouds_and_then_over_streets(self) -> None:
        def cloud(ransac: float | None, icp: float | None) -> dict[str, object]:
            return {"aligned_m": 1.0, "ransac_m": ransac, "icp_m": icp, "thickness_m": 0.1}

        written = {"streets": [{"true_thickness_m": 0.04, "clouds": [cloud(1.0, 0.5), cloud(3.0, 1.5)]},
                               {"true_thickness_m": 0.06, "clouds": [cloud(4.0, 2.0), cloud(None, None)]}]}
        found = table2.figures(written)
        self.assertEqual((found["ransac_m_1"], found["ransac_m_2"], found["ransac_m"]), (2.0, 4.0, 3.0))
        self.assertEqual((found["icp_m"], found["clouds"], found["not_found"]), (1.5, 4, 1))
        text = table2.markdown([Result("w", "best", 1, found)], [WorldNote("w", "f00d", 3, 1)],
                               {"w": (2, table2.true_thickness(written))})
        self.assertIn("2 streets; thickness by true poses 0.0500 m", text)
        self.assertIn("2: ICP", text)
        self.assertNotIn("3: ICP", text)

    def test_numbers_have_so_many_digits(self) -> None:
        self.assertEqual([figure(v) for v in (0.012345, 1.0, 12.34, 12345.6, math.nan, -0.5)],
                         ["0.0123", "1", "12.3", "12346", "-", "-0.500"])
        self.assertEqual(spread([math.nan, math.nan]), "-")
        self.assertEqual(interval((math.nan, 1.0)), "-")


class RowsAndWorlds(Scratch):
    best = {"closures.method": "point_to_plane", "chain.reach": "4", "merge.min_fitness": "0.3", "graph.anchor": "1",
            "keyframes.distance": "1", "merge.min_travel": "4"}
    paper = {"closures.method": "point_to_point", "chain.reach": "0", "merge.min_fitness": "0.3", "graph.anchor": "1",
             "keyframes.distance": "3", "merge.min_travel": "0"}

    def test_an_ablation_puts_back_what_the_paper_does_in_one_subject(self) -> None:
        slower = self.paper | {"chain.reach": "4", "merge.min_travel": "9"}
        found = {row.name: row for row in ablations({"nclt": (self.best, self.paper), "mars": (self.best, slower)})}
        self.assertEqual({name: row.settings_on("nclt") for name, row in found.items()},
                         {"ablation-keyframes": ("keyframes.distance=3",),
                          "ablation-registration": ("closures.method=point_to_point",),
                          "ablation-chain-reach": ("chain.reach=0",),
                          "ablation-merge-candidates": ("merge.min_travel=0",)})
        self.assertEqual(found["ablation-merge-candidates"].settings_on("mars"), ("merge.min_travel=9",))
        self.assertEqual(found["ablation-chain-reach"].settings_on("mars"), ())
        self.assertIn("nclt: merge.min_travel=0; mars: merge.min_travel=9", found["ablation-merge-candidates"].definition)

    def test_fixes_and_gravity_are_subjects_of_their_own(self) -> None:
        best = {"graph.gnss": "true", "graph.gravity": "true", "graph.gravity_window": "10"}
        paper = {"graph.gnss": "false", "graph.gravity": "false", "graph.gravity_window": "10"}
        self.assertEqual(differing(best, paper), {"gnss": ("graph.gnss=false",), "gravity": ("graph.gravity=false",)})

    def test_a_setting_that_no_subject_has_is_an_error(self) -> None:
        with self.assertRaisesRegex(RowError, "chain.new_bound"):
            subject_of("chain.new_bound")

    def test_rows_by_name(self) -> None:
        extra = ablations({"nclt": (self.best, self.paper)})
        self.assertEqual(chosen([], extra), list(MAIN_ROWS))
        self.assertNotIn(OWN_ROW, MAIN_ROWS)  # which would take most of the time
        self.assertEqual(chosen(["main", "best-own"], extra), [*MAIN_ROWS, OWN_ROW])
        self.assertEqual([r.name for r in chosen(["best", "ablations"], extra)][:2], ["best", "ablation-keyframes"])
        with self.assertRaisesRegex(RowError, "there is no row beste"):
            chosen(["beste"], extra)

    def test_worlds_by_name_and_by_folder(self) -> None:
        drive = self.root / "2012-01-08"
        drive.mkdir()
        (drive / "velodyne_hits.bin").touch()
        found = worlds(["mars-hard", str(drive)], "small", 2, 3)
        self.assertEqual(found[0].data(2)[2], "simulate:mars-hard/small/3/2")
        self.assertEqual((found[1].platform, found[1].seeds, found[1].sessions), ("nclt", 1, (str(drive),)))
        with self.assertRaisesRegex(WorldError, "no such folder"):
            worlds([str(self.root / "none")], "small", 1)
        car = self.root / "07"
        car.mkdir()
        with self.assertRaisesRegex(WorldError, "cannot be one world"):
            worlds([str(drive), str(car)], "small", 1)

    def test_a_scene_of_mars_is_named_below_its_tables(self) -> None:
        (self.root / "v1.0").mkdir()
        self.assertEqual(worlds([str(self.root / "scene-1")], "small", 1)[0].platform, "mars")

    def test_routes_are_simulated_on_each_drive_in_the_world_of_all(self) -> None:
        with self.assertRaisesRegex(WorldError, "CHAINSLAM_DATA"):
            worlds(["nclt-routes"], "small", 1)
        with self.assertRaisesRegex(WorldError, "needs trajectories/nclt/2012-01-08/groundtruth.csv"):
            worlds(["nclt-routes"], "small", 1, data=self.root)
        for day in ("2012-01-08", "2012-04-29", "2012-08-04"):
            (self.root / "trajectories/nclt" / day).mkdir(parents=True)
            (self.root / "trajectories/nclt" / day / "groundtruth.csv").write_text(day)
        world = worlds(["nclt-routes"], "small", 2, data=self.root)[0]
        self.assertEqual([recipe.count("--also") for recipe in world.recipes], [2, 2, 2])
        program = self.root / "chainslam"
        program.touch()
        task = Plan(Programs(program)).odometry(world, 2, 1, "fast_lio2")
        self.assertIn("simulate:{0}/drive", task.commands[0])
        self.assertEqual(task.commands[0][-2:], ("--max-scans", "900"))
        self.assertIn("2012-04-29", task.after[0].commands[0][3])
        self.assertEqual(task.after[0].commands[0][-4:-2], ("--seed", "2"))

    def test_other_files_make_another_world(self) -> None:
        names = [str(self.root)]
        before = worlds(names, "small", 1)[0].identity
        self.assertEqual(worlds(names, "small", 1)[0].identity, before)
        (self.root / "imu.csv").write_text("1")
        self.assertNotEqual(worlds(names, "small", 1)[0].identity, before)

    def test_rows_share_recordings_and_nothing_that_differs(self) -> None:
        program = self.root / "chainslam"
        program.write_text("1")
        plan, world = Plan(Programs(program)), simulated("nclt-hard", "small", 2, 2)
        rows = {row.name: row for row in MAIN_ROWS}
        rows[OWN_ROW.name] = OWN_ROW
        tasks = {name: plan.map(world, 1, rows[name]).task for name in ("chained", "best", "best-own")}
        self.assertEqual(tasks["chained"].after, tasks["best"].after)
        self.assertNotEqual(tasks["best"].after, tasks["best-own"].after)
        self.assertIn("preset=paper", tasks["chained"].after[0].commands[0])
        self.assertNotEqual(tasks["chained"].digest, plan.map(world, 2, rows["chained"]).task.digest)
        before = tasks["chained"].digest
        elsewhere = self.root / "elsewhere"
        elsewhere.write_text("1")
        self.assertEqual(Plan(Programs(elsewhere)).map(world, 1, rows["chained"]).task.digest, before)
        program.write_text("2")  # another program: nothing of the old one counts
        self.assertNotEqual(plan.map(world, 1, rows["chained"]).task.digest, before)
        with self.assertRaisesRegex(TaskFailed, "lamm is not built"):
            plan.map(world, 1, rows["lamm"])

    def test_recordings_of_an_earlier_build_are_kept(self) -> None:
        earlier, later = self.root / "earlier", self.root / "later"
        earlier.write_text("1")
        later.write_text("2")
        world = simulated("nclt-hard", "small", 1, 2)
        before = Plan(Programs(earlier)).map(world, 1, MAIN_ROWS[-1]).task
        plan = Plan(Programs(later, recorder=earlier))
        after = plan.map(world, 1, MAIN_ROWS[-1]).task
        self.assertEqual(after.after, before.after)
        self.assertNotEqual(after.digest, before.digest)
        self.assertEqual(plan.timed_odometry(world, 1, "fast_lio2").commands[0][0], "{chainslam}")
        self.assertEqual(Programs(later).names()["recorder"], str(later))

    def test_maps_of_published_systems_by_an_earlier_build_are_kept(self) -> None:
        earlier, later = self.root / "earlier", self.root / "later"
        earlier.write_text("1")
        later.write_text("2")
        world, rows = simulated("nclt-hard", "small", 1, 2), {row.name: row for row in MAIN_ROWS}
        plan = Plan(Programs(later, lamm=earlier, recorder=earlier, published=earlier))
        for name, row in rows.items():
            task = plan.map(world, 1, row).task
            is_published = not name.startswith("best")
            self.assertEqual(task.names, (("chainslam", str(earlier if is_published else later)),))
            before = Plan(Programs(earlier, lamm=earlier)).map(world, 1, row).task
            self.assertEqual(task.digest == before.digest, is_published)
            self.assertEqual(task.alone, name.startswith("lamm"))  # table 4 has its times

    def test_each_session_of_a_sequence_loads_the_map_before(self) -> None:
        program = self.root / "chainslam"
        program.touch()
        runs = Plan(Programs(program)).sequence(simulated("nclt-hard", "small", 1, 3), 1, MAIN_ROWS[-1], True)
        self.assertEqual(len(runs), 3)
        self.assertNotIn("--load", runs[0].task.commands[0])
        self.assertIn("{1}/map/map.cslam", runs[2].task.commands[0])
        self.assertEqual(runs[2].task.after[1], runs[1].task)
        self.assertTrue(all(run.task.alone for run in runs))
        last = Plan(Programs(program)).sequence(simulated("nclt-hard", "small", 1, 3), 1, MAIN_ROWS[-1], False)
        self.assertEqual([run.task.alone for run in last], [False, False, True])

    def test_drawn_graphs_have_the_settings_in_which_a_row_differs_from_its_source(self) -> None:
        program = self.root / "program"
        program.touch()
        plan, world = Plan(Programs(program, graph_seeds=program)), simulated("nclt-hard", "small", 1, 3)
        rows = {row.name: row for row in MAIN_ROWS}
        for name, source in GRAPH_SOURCES.items():
            command = plan.graph_seeds(world, rows[name], rows[source]).task.commands[0]
            overrides = [command[i + 1] for i, word in enumerate(command) if word == "--set"]
            self.assertEqual(overrides, ["chain.enabled=false"] if "unchained" in name else [])
            self.assertNotIn("map/map.cslam", plan.map(world, 1, rows[source]).task.drop)
        self.assertIn("map/map.cslam", plan.map(world, 1, rows["released"]).task.drop)


class CommandLine(unittest.TestCase):
    def refused(self, *words: str) -> str:
        stream = io.StringIO()
        with contextlib.redirect_stderr(stream), self.assertRaises(SystemExit) as end:
            checked(list(words))
        self.assertEqual(end.exception.code, 2)
        return stream.getvalue()

    def test_defaults(self) -> None:
        arguments = checked([])
        self.assertEqual((arguments.tables, arguments.size, arguments.seeds, arguments.sessions),
                         (list(TABLES), "small", 1, 3))
        self.assertEqual(checked(["1", "--size", "medium"]).seeds, 3)

    def test_what_is_not_there_is_said(self) -> None:
        self.assertIn("there is no table 9; tables: 1, 2, 3, graph", self.refused("9"))
        self.assertIn("no world and no folder", self.refused("--world", "nowhere"))
        self.assertIn("at least 1", self.refused("--seeds", "0"))
        self.assertIn("begin table5 medium", self.refused("1", "5", "--size", "medium", "--readme"))


class Readme(unittest.TestCase):
    text = "a\n<!-- begin table1 small -->\nold\n<!-- end table1 small -->\nb\n"

    def test_a_result_replaces_the_one_before_and_nothing_else(self) -> None:
        once = with_result(self.text, "table1", "small", "# T\n\nnew\n")
        self.assertEqual(once, "a\n<!-- begin table1 small -->\n## T\n\nnew\n<!-- end table1 small -->\nb\n")
        self.assertEqual(with_result(once, "table1", "small", "# T\n\nnew\n"), once)

    def test_results_of_other_worlds_stay(self) -> None:
        def both(first: str, second: str) -> str:
            return f"# T\n\n{first}\n\n## a/small\n\n{first}\n\n# U\n\n## a/small: 2 minutes\n\n{second}\n"

        old = with_result(self.text, "table1", "small", both("one", "two"))
        self.assertNotIn("old", old)
        other = with_result(old, "table1", "small", both("three", "four").replace("a/", "b/"))
        self.assertEqual(other, "a\n<!-- begin table1 small -->\n## T\n\nthree\n\n### a/small\n\none\n\n"
                         "### b/small\n\nthree\n\n## U\n\n### a/small: 2 minutes\n\ntwo\n\n"
                         "### b/small: 2 minutes\n\nfour\n<!-- end table1 small -->\nb\n")
        again = with_result(other, "table1", "small", both("five", "six"))
        self.assertEqual(again, other.replace("three", "five", 1).replace("one", "five").replace("two", "six"))

    def test_without_markers_nothing_is_written(self) -> None:
        for text in ("a", self.text + self.text):
            with self.assertRaises(MarkerError):
                with_result(text, "table1", "small", "new")


if __name__ == "__main__":
    unittest.main()
