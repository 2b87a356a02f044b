"""Tasks: commands whose results are folders that are there whole or not at all, and that are run once."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

OUT = "{out}"  # in a command: the folder that the task fills
THREADS = "{threads}"  # in a command: how many threads it may use, which changes its time and not its result


@dataclass(frozen=True)
class Task:
    """Commands that fill one folder.

    A command's words may contain `{out}`, `{threads}`, `{0}`, `{1}` ... for the folders of `after`, and names that the
    runner knows, such as those of programs: where they lie is nothing that a result depends on.
    """

    name: str
    commands: tuple[tuple[str, ...], ...]
    after: tuple[Task, ...] = ()
    depends: tuple[str, ...] = ()  # what else the result depends on: identities of programs and data
    alone: bool = False  # its time is a result: nothing else runs meanwhile
    drop: tuple[str, ...] = ()  # patterns of files below the folder that nobody needs afterwards
    names: tuple[tuple[str, str], ...] = ()  # of this task where the runner's differ; `depends` has what they stand for

    @property
    def digest(self) -> str:
        """Of all that the result depends on."""
        parts = [self.commands, self.depends, self.drop, self.alone, [task.digest for task in self.after]]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]

    @property
    def folder(self) -> str:
        return f"{self.name.replace('/', '-')}-{self.digest}"


class TaskFailed(Exception):
    """A command of a task ended with an error."""


def content_digest(path: Path) -> str:
    """Identity of a program or script: a hash of its bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def in_order(tasks: Iterable[Task]) -> list[Task]:
    """Each task once, behind those that it comes after."""
    ordered: dict[str, Task] = {}

    def add(task: Task) -> None:
        if task.folder in ordered:
            return
        for before in task.after:
            add(before)
        ordered[task.folder] = task

    for task in tasks:
        add(task)
    return list(ordered.values())


@contextmanager
def locked(root: Path) -> Iterator[int]:
    """Keeps a second run away from the same folder.

    @returns the lock's descriptor: commands that inherit it hold the lock if they outlive the run.
    """
    root.mkdir(parents=True, exist_ok=True)
    with open(root / ".lock", "w", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise TaskFailed(f"{root} is in use by another run; wait for it, or give another --out") from error
        yield lock.fileno()


class Runner:
    """Runs tasks, several at a time, and keeps what they made below one folder."""

    def __init__(
        self,
        root: Path,
        jobs: int,
        say: Callable[[str, str], None],
        accepted: Sequence[int] = (0,),
        names: Mapping[str, str] | None = None,
    ) -> None:
        """@param names  what `{name}` stands for in a command."""
        self.root = root
        self.lock: int | None = None  # descriptor that commands inherit
        self.names = {f"{{{name}}}": word for name, word in (names or {}).items()}
        self.jobs = max(1, jobs)
        self.say = say
        self.accepted = tuple(accepted)
        self._begun = time.monotonic()
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def path(self, task: Task) -> Path:
        return self.root / task.folder

    def is_done(self, task: Task) -> bool:
        return self.path(task).is_dir()

    def run(self, tasks: Iterable[Task]) -> dict[str, str]:
        """Runs what is not done yet.

        @returns the reason for each task that failed or could not begin, by its folder.
        """
        ordered = in_order(tasks)
        self._remove_unfinished()
        waiting = [task for task in ordered if not self.is_done(task)]
        total, failed = len(waiting), dict[str, str]()
        if len(ordered) > total:
            self.say("tasks", f"{len(ordered) - total} of {len(ordered)} are there from an earlier run")
        running: dict[Future[float], Task] = {}
        done = 0
        with ThreadPoolExecutor(self.jobs) as pool:
            try:
                while waiting or running:
                    for task in self._ready(waiting, running, failed):
                        waiting.remove(task)
                        running[pool.submit(self._make, task)] = task
                    if not running:
                        break  # the rest comes after what failed
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        task = running.pop(future)
                        done += 1
                        self._report(task, future, f"{done}/{total}", failed)
            except KeyboardInterrupt:
                self._stop()
                raise
        for task in waiting:
            cause = next(before.name for before in task.after if before.folder in failed)
            failed[task.folder] = f"not begun: {cause} failed"
        return failed

    def _ready(self, waiting: list[Task], running: dict[Future[float], Task], failed: dict[str, str]) -> list[Task]:
        """What can begin now. A task that wants to be alone begins when nothing runs, and keeps others waiting."""
        for task in list(waiting):
            if any(before.folder in failed for before in task.after):
                waiting.remove(task)
                cause = next(before.name for before in task.after if before.folder in failed)
                failed[task.folder] = f"not begun: {cause} failed"
        if any(task.alone for task in running.values()):
            return []
        ready = [task for task in waiting if all(self.is_done(before) for before in task.after)]
        together = [task for task in ready if not task.alone][: self.jobs - len(running)]
        if together or running:
            return together
        return ready[:1]

    def _report(self, task: Task, future: Future[float], count: str, failed: dict[str, str]) -> None:
        minutes = (time.monotonic() - self._begun) / 60
        try:
            self.say("done", f"{task.name}: {future.result():.0f} s ({count}, {minutes:.1f} min)")
        except TaskFailed as error:
            failed[task.folder] = str(error)
            self.say("FAILED", f"{task.name} ({count}): {error}")

    def _make(self, task: Task) -> float:
        begin = time.monotonic()
        part = self.root / f"{task.folder}.part"
        part.mkdir(parents=True)
        shutil.rmtree(self.root / f"{task.folder}.failed", ignore_errors=True)
        words = self.names | {f"{{{name}}}": word for name, word in task.names}
        words |= {f"{{{i}}}": str(self.path(before)) for i, before in enumerate(task.after)}
        words |= {OUT: str(part), THREADS: str(os.cpu_count() or 1) if task.alone else "1"}
        records = []
        for command in task.commands:
            try:
                records.append(self._execute([_filled(word, words) for word in command], part / "log.txt"))
            except TaskFailed:
                if not self._stopped:
                    part.rename(self.root / f"{task.folder}.failed")
                raise
        for pattern in task.drop:
            for file in part.glob(pattern):
                file.unlink()
        (part / "task.json").write_text(json.dumps({"name": task.name, "commands": records}, indent=1) + "\n")
        part.rename(self.path(task))
        return time.monotonic() - begin

    def _execute(self, words: list[str], log: Path) -> dict[str, object]:
        begin = time.monotonic()
        with open(log, "ab") as output:
            output.write(("$ " + " ".join(words) + "\n").encode())
            output.flush()
            with self._lock:
                if self._stopped:
                    raise TaskFailed("interrupted")
                process = subprocess.Popen(
                    words,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=() if self.lock is None else (self.lock,),
                )
                self._processes.add(process)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            with self._lock:
                self._processes.discard(process)
        if process.returncode not in self.accepted:
            last = [line for line in log.read_text(errors="replace").splitlines() if line.strip()][-1]
            failed = str(log).replace(".part", ".failed")
            raise TaskFailed(f"{Path(words[0]).name} ended with {process.returncode}: {last} (log: {failed})")
        return {
            "words": words,
            "exit_code": process.returncode,
            "wall_seconds": time.monotonic() - begin,
            # Not usage.ru_maxrss: what begins as a copy of this process has at least its memory at its peak.
            "processor_seconds": usage.ru_utime + usage.ru_stime,
        }

    def _stop(self, patience: float = 10.0) -> None:
        """Ends the commands that run, first kindly; what they have made is removed by the next run."""
        with self._lock:
            self._stopped = True
            for process in self._processes:
                process.terminate()
        end = time.monotonic() + patience
        while self._processes and time.monotonic() < end:
            time.sleep(0.1)
        with self._lock:
            for process in self._processes:
                process.kill()

    def _remove_unfinished(self) -> None:
        for part in self.root.glob("*.part"):
            shutil.rmtree(part)


def _filled(word: str, values: Mapping[str, str]) -> str:
    for name, value in values.items():
        word = word.replace(name, value)
    return word


def say(label: str, text: str) -> None:
    """One line of progress, as the other scripts print it."""
    stream = sys.stderr if label in ("FAILED", "failed") else sys.stdout
    print(f"{label:<12} {text}", file=stream, flush=True)
