"""The command line behind run.sh."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from . import readme
from .rows import RowError
from .tasks import TaskFailed, say
from .worlds import NAMES, SIZES, WorldError, is_data

TABLES = {
    "1": "pose errors",
    "2": "registration of streets",
    "3": "viewpoints",
    "graph": "many worlds drawn from what runs have measured",
    "4": "efficiency",
    "5": "growth with sessions",
}
DEFAULT_WORLDS = ["nclt-hard", "mars-hard"]
DEFAULT_SEEDS = {"small": 1, "medium": 3, "large": 1}
DEFAULT_SESSIONS = {"small": 3, "medium": 5, "large": 5}


def parser() -> argparse.ArgumentParser:
    tables = ", ".join(f"{name} ({what})" for name, what in TABLES.items())
    command = argparse.ArgumentParser(
        prog="bench/experiments/run.sh",
        allow_abbrev=False,
        description="Makes the paper's tables: records odometry once, runs every row on it, writes TABLE.json, TABLE.md "
        "and figures. Interrupted or run again, it goes on with what is missing.",
        epilog="environment: CHAINSLAM_BUILD_DIR (default: build/), CHAINSLAM_JOBS (tasks at a time; default: all cores)",
    )
    command.add_argument("tables", nargs="*", metavar="TABLE", help=f"{tables}; default: all")
    command.add_argument("--world", nargs="+", metavar="WORLD|PATH", default=DEFAULT_WORLDS, dest="worlds",
                         help=f"{', '.join(NAMES)}; or the sessions of one data set as folders, in their order")
    command.add_argument("--size", choices=SIZES, default="small", help="of simulated worlds (default: small)")
    command.add_argument("--seeds", type=int, metavar="N", help="worlds of each kind (default: medium 3, else 1)")
    command.add_argument("--sessions", type=int, metavar="N", help="of simulated worlds (default: small 3, else 5)")
    command.add_argument("--rows", nargs="+", metavar="ROW", default=[],
                         help="names, main (default; all but best-own), or ablations: best with what the paper does, one "
                         "subject at a time")
    build = Path(os.environ.get("CHAINSLAM_BUILD_DIR") or Path(__file__).parents[2] / "build")
    command.add_argument("--out", type=Path, metavar="DIR", default=build / "experiments",
                         help="default: build/experiments")
    command.add_argument("--readme", action="store_true",
                         help="also put the tables into bench/experiments/README.md, between its markers; those of other "
                         "worlds stay there")
    command.add_argument("--recorder", type=Path, metavar="PROGRAM",
                         help="an earlier build of chainslam, whose recordings of odometry are kept; the tables name it")
    command.add_argument("--published", type=Path, metavar="PROGRAM",
                         help="likewise: maps of published systems (LAMM, presets paper and released) are kept")
    for hidden in ("--program", "--lamm", "--graph-seeds", "--street-registration", "--viewpoints"):
        command.add_argument(hidden, type=Path, help=argparse.SUPPRESS)
    command.add_argument("--check", action="store_true", help=argparse.SUPPRESS)
    return command


def checked(words: list[str]) -> argparse.Namespace:
    """The command line, or the end with exit code 2 and a sentence."""
    command = parser()
    arguments = command.parse_args(words)
    for name in arguments.tables:
        if name not in TABLES:
            command.error(f"there is no table {name}; tables: {', '.join(TABLES)}")
    arguments.tables = arguments.tables or list(TABLES)
    if arguments.seeds is None:
        arguments.seeds = DEFAULT_SEEDS[arguments.size]
    if arguments.sessions is None:
        arguments.sessions = DEFAULT_SESSIONS[arguments.size]
    if arguments.seeds < 1:
        command.error("--seeds: at least 1")
    if not 2 <= arguments.sessions <= 5:
        command.error("--sessions: from 2 to 5")
    for option in ("recorder", "published"):
        program = getattr(arguments, option)
        if program and not os.access(program, os.X_OK):
            command.error(f"--{option} {program}: no program of that name")
    if arguments.readme:
        try:
            for name in [*arguments.tables, "cost"]:
                readme.places(readme.README.read_text(), readme.file_name(name), arguments.size)
        except readme.MarkerError as error:
            command.error(f"--readme: {error}")
    for name in arguments.worlds:
        if name not in NAMES and not is_data(Path(name)):
            command.error(f"--world {name}: no world and no folder of that name; worlds: {', '.join(NAMES)}")
    return arguments


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def main() -> int:
    arguments = checked(sys.argv[1:])
    if arguments.check:
        return 0
    signal.signal(signal.SIGTERM, _interrupt)
    from .make import Maker  # which needs numpy and matplotlib

    jobs = int(os.environ.get("CHAINSLAM_JOBS") or os.cpu_count() or 1)
    try:
        return Maker(arguments, jobs).make()
    except (TaskFailed, RowError, WorldError) as error:
        say("failed", str(error))
        return 1
    except KeyboardInterrupt:
        say("failed", "interrupted; the same command goes on from here")
        return 130


if __name__ == "__main__":
    sys.exit(main())
