"""Tasks are run once, whole or not at all, and in the order that they need."""

import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

from experiments.tasks import Runner, Task, TaskFailed, in_order, locked


def shell(name: str, script: str, after: tuple[Task, ...] = (), alone: bool = False, depends: tuple[str, ...] = ()) -> Task:
    return Task(name, (("sh", "-c", script),), after, depends, alone)


class Tasks(unittest.TestCase):
    def setUp(self) -> None:
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.root = Path(scratch.name) / "tasks"
        self.root.mkdir()
        self.said: list[tuple[str, str]] = []

    def runner(self, jobs: int = 2) -> Runner:
        return Runner(self.root, jobs, lambda label, text: self.said.append((label, text)))

    def test_a_second_run_does_nothing_that_is_done(self) -> None:
        log = self.root.parent / "log"
        first = shell("first", f"echo first >>{log}; echo 1 >{{out}}/result")
        second = shell("second", f"echo second >>{log}; cat {{0}}/result >{{out}}/copy", (first,))
        self.assertEqual(self.runner().run([second]), {})
        self.assertEqual(self.runner().run([second, first]), {})
        self.assertEqual(log.read_text().split(), ["first", "second"])
        self.assertEqual((self.root / second.folder / "copy").read_text(), "1\n")

    def test_what_was_interrupted_is_done_again_and_nothing_else(self) -> None:
        log = self.root.parent / "log"
        first = shell("first", f"echo first >>{log}; touch {{out}}/a")
        self.runner().run([first])
        second = shell("second", f"echo second >>{log}; test ! -e {{out}}/half", (first,))
        left = self.root / f"{second.folder}.part"
        left.mkdir()
        (left / "half").touch()  # as a killed run leaves it
        self.assertFalse(self.runner().is_done(second))
        self.assertEqual(self.runner().run([second]), {})
        self.assertTrue(self.runner().is_done(second))
        self.assertEqual(log.read_text().split(), ["first", "second"])
        self.assertEqual(list(self.root.glob("*.part")), [])

    def test_a_failure_is_told_with_its_last_line_and_stops_only_what_needs_it(self) -> None:
        bad = shell("bad", "echo the disk is full; exit 4")
        behind, other = shell("behind", "true", (bad,)), shell("other", "true")
        failed = self.runner().run([behind, other])
        self.assertIn("ended with 4: the disk is full", failed[bad.folder])
        self.assertEqual(failed[behind.folder], "not begun: bad failed")
        self.assertTrue(self.runner().is_done(other))
        self.assertFalse(self.runner().is_done(bad))
        self.assertTrue((self.root / f"{bad.folder}.failed/log.txt").is_file())
        self.assertIn(bad.folder, self.runner().run([bad]))  # tried again, not taken as done

    def test_a_task_that_wants_to_be_alone_is(self) -> None:
        running = self.root.parent / "running"
        busy = [shell(f"busy{i}", f"touch {running}{i}; sleep 0.2; rm {running}{i}") for i in range(3)]
        alone = shell("alone", f"! ls {running}* 2>/dev/null", alone=True)
        self.assertEqual(self.runner().run([alone, *busy]), {})

    def test_as_many_run_at_a_time_as_asked_for(self) -> None:
        folder = self.root.parent / "now"
        folder.mkdir()
        most = 0
        done = threading.Event()

        def watch() -> None:
            nonlocal most
            while not done.is_set():
                most = max(most, len(list(folder.iterdir())))
                time.sleep(0.01)

        watcher = threading.Thread(target=watch)
        watcher.start()
        tasks = [shell(f"t{i}", f"touch {folder}/{i}; sleep 0.3; rm {folder}/{i}") for i in range(6)]
        self.runner(2).run(tasks)
        done.set()
        watcher.join()
        self.assertEqual(most, 2)

    def test_a_folders_name_changes_with_all_that_the_result_depends_on(self) -> None:
        before = shell("before", "true")
        tasks = [shell("a", "true"), shell("a", "false"), shell("a", "true", (before,)), shell("a", "true", depends=("1",)),
                 shell("a", "true", (shell("before", "true", depends=("other",)),)), shell("b", "true")]
        self.assertEqual(len({task.folder for task in tasks}), len(tasks))
        self.assertEqual(shell("a", "true").folder, tasks[0].folder)

    def test_tasks_come_once_and_behind_what_they_need(self) -> None:
        first = shell("first", "true")
        second, third = shell("second", "true", (first,)), shell("third", "true", (first,))
        self.assertEqual([t.name for t in in_order([third, second, first])], ["first", "third", "second"])

    def test_two_runs_do_not_share_a_folder(self) -> None:
        with locked(self.root), self.assertRaises(TaskFailed), locked(self.root):
            pass

    def test_a_name_stands_for_a_program_wherever_it_lies(self) -> None:
        task = Task("t", (("{shell}", "-c", "echo $0 >{out}/said", "{threads}"),))
        runner = Runner(self.root, 1, lambda label, text: None, names={"shell": "/bin/sh"})
        self.assertEqual(runner.run([task]), {})
        self.assertEqual((self.root / task.folder / "said").read_text(), "1\n")

    def test_a_task_may_have_a_program_of_its_own(self) -> None:
        command = (("{shell}", "-c", "echo $0 >{out}/result", "{shell}"),)
        runner = Runner(self.root, 1, lambda label, text: None, names={"shell": "/bin/sh"})
        other = Task("other", command, depends=("bash",), names=(("shell", "/bin/bash"),))
        self.assertEqual(runner.run([Task("one", command), other]), {})
        self.assertEqual((runner.path(other) / "result").read_text(), "/bin/bash\n")
        self.assertEqual(other.digest, Task("other", command, depends=("bash",)).digest)

    def test_a_command_that_outlives_its_run_keeps_the_folder(self) -> None:
        with locked(self.root) as lock:
            left = subprocess.Popen(["sleep", "60"], pass_fds=(lock,))
        with self.assertRaisesRegex(TaskFailed, "in use by another run"), locked(self.root):
            pass
        left.kill()
        left.wait()
        with locked(self.root):
            pass

    def test_an_interrupt_ends_commands_and_the_next_run_goes_on(self) -> None:
        script = f"""
import sys
from pathlib import Path
from experiments.tasks import Runner, Task, say
stubborn = ("sh", "-c", "trap '' TERM; touch {{out}}/ready; exec sleep 100")
tasks = [Task("quick", (("true",),)), Task("long", (stubborn,))]
Runner(Path({str(self.root)!r}), 2, say).run(tasks)
"""
        run = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert run.stdout is not None
        run.stdout.readline()  # quick is done
        while not list(self.root.glob("long-*.part/ready")):
            time.sleep(0.05)
        begin = time.monotonic()
        run.send_signal(signal.SIGINT)
        self.assertNotEqual(run.wait(), 0)
        run.stdout.close()
        self.assertLess(time.monotonic() - begin, 30)
        self.assertEqual(len(list(self.root.glob("quick-*"))), 1)
        self.assertEqual(list(self.root.glob("*.failed")), [])
        self.assertEqual(self.runner().run([Task("quick", (("true",),)), shell("long", "true")]), {})

    def test_what_a_command_costs_is_recorded(self) -> None:
        task = shell("t", "true")
        self.runner().run([task])
        text = (self.root / task.folder / "task.json").read_text()
        self.assertIn("processor_seconds", text)


if __name__ == "__main__":
    unittest.main()
