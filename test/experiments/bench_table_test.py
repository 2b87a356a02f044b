"""The Markdown tables of bench/run.sh --table."""

import json
import tempfile
import unittest
from pathlib import Path

import benchmark_tables


class BenchTable(unittest.TestCase):
    def setUp(self):
        self.folder = Path(self.enterContext(tempfile.TemporaryDirectory()))

    def write(self, name, runs):
        context = {"date": "2026-03-04T05:06:07+00:00"}
        file = self.folder / name
        file.write_text(json.dumps({"context": context, "benchmarks": runs}))
        return file

    def test_a_table_for_each_module_with_a_column_for_each_peer(self):
        run = {"name": "search/knn", "run_type": "iteration", "cpu_time": 489.26, "real_time": 500.0, "time_unit": "ns"}
        search = self.write(
            "search.json",
            [
                run | {"speedup_vs_nanoflann": 5.3, "rss_mb": 12.0},
                run | {"name": "search/radius"},
                run | {"name": "search/grow/iterations:3/manual_time"},
                run | {"name": "search/build", "speedup_vs_nanoflann": 0.9},
            ],
        )
        lie = self.write("lie_plain.json", [run | {"name": "lie/exp", "cpu_time": 12345.0}])
        empty = self.folder / "io.json"
        empty.write_text("")
        out = self.folder / "table.md"
        self.assertEqual(benchmark_tables.main([str(out), "bench/run.sh", "g++ 12.2, nanoflann 1.4", str(search), str(lie), str(empty)]), 0)
        text = out.read_text()
        self.assertIn("# Benchmarks of 2026-03-04\n\n`bench/run.sh`\n", text)
        self.assertIn("; g++ 12.2, nanoflann 1.4.\n", text)
        self.assertIn("## search\n\n| benchmark | ours | nanoflann | figures |", text)
        self.assertIn("| `search/knn` | 489 ns | 5.30 | rss_mb 12 |", text)
        self.assertIn("| `search/radius` | 489 ns |  |  |", text)
        self.assertIn("| `search/grow` | 500 ns |  |  |", text)
        self.assertIn("| `search/build` | 489 ns | **0.900** |  |", text)
        self.assertIn("## lie, plain x86-64\n\n| benchmark | ours | figures |", text)
        self.assertIn("| `lie/exp` | 12345 ns |", text)
        self.assertNotIn("## io", text)

    def test_medians_of_repetitions_are_not_counted_as_runs(self):
        run = {"name": "a/b", "cpu_time": 1.0, "time_unit": "ms"}
        rows = benchmark_tables.rows_of({"benchmarks": [run | {"run_type": "iteration"}, run | {"run_type": "aggregate"}]})
        self.assertEqual(len(rows), 1)


if __name__ == "__main__":
    unittest.main()
