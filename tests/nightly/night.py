"""The evidence of one night: statistics, long recordings, damaged files, other programs and benches, on one machine.

    bash .ci/nightly night-1            # four hours at most
    bash .ci/nightly night-1 --small    # the smallest sizes: whether every stage runs
    bash .ci/nightly night-1 --stage fuzz

The folder gets a log of each command, and results.jsonl with command, figure, value, date, the machine's load at the
start of the command, and its duration. The same words continue a night that was ended: commands in results.jsonl are
not repeated, nor is work that a command stores itself. A stage starts no command after its share of the time; commands
that still run then are ended, and started again next time. The longest commands start first.
"""

import argparse
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from tests.lab import ROOT
from tests.nightly.readers import READERS

LONGEST = ("test_memory.py", "test_flight_fits.py", "test_demo.py")  # 40 minutes and more: started first
ENDED = "exit code"
TIME_LIMIT = "none: ended at its time limit"
FUZZ_CASES = 100_000  # of all readers
# Tests that wait for swings more than they compute, with the number of workers. Only one such file runs at a time,
# ahead of programs that compute: with two, devices answered too late.
WORKERS = {"test_guided_campaign.py": 2, "test_killed_runs.py": 0}
_AHEAD = "-10"  # a value of `nice`
_LOOK_S = 0.1
_asked_to_end = threading.Event()

Line = Mapping[str, Any]


class Stage(NamedTuple):
    """Commands, with {size} in place of their size, their sizes, the minutes of the stage, and how many run at once."""

    commands: tuple[str, ...]
    size: str
    small: str
    minutes: float
    at_once: int = 1


def _slow_tests() -> tuple[str, ...]:
    files = sorted(path for path in ROOT.glob("tests/*/test_*.py") if "mark.slow" in path.read_text(encoding="utf-8"))
    how = {path: f"-n {count} -rP" if (count := WORKERS.get(path.name)) else "-n 0 -s" for path in files}
    return tuple(f"pytest -q -m slow {how[path]} {{size}}{path.relative_to(ROOT)}" for path in files)


def _benches() -> tuple[str, ...]:
    sized = {"encoder_logger": "BENCH_SECONDS", "loadcell_logger": "BENCH_SECONDS"}
    names = sorted(path.stem for path in ROOT.glob("tests/bench/*.py"))
    commands = (f"{f'{sized[name]}={{size}} ' if name in sized else ''}python tests/bench/{name}.py" for name in names)
    return (*commands, "python tests/bench/transfer_identify.py 7000")


STAGES = {
    "benches": Stage(_benches(), "60", "10", 25),
    "soak": Stage(("python -m tests.nightly.soak --virtual {size}",), "3600 --real 600", "60 --real 20", 15),
    "fuzz": Stage(
        tuple(f"python -m tests.nightly.fuzz --reader {shlex.quote(one.name)} --cases {{size}}" for one in READERS),
        str(FUZZ_CASES // len(READERS)), "100", 25, at_once=2,
    ),
    "consumers": Stage(("bash .ci/consumers",), "", "", 5),
    "slow": Stage(_slow_tests(), "", "--collect-only ", 150, at_once=4),  # some tests wait for motors
    "coverage": Stage(
        ("python -m tests.nightly.coverage {size} --jobs 2 --out {folder}/coverage.jsonl",), "--minutes 15", "--n 1", 17
    ),
}  # fmt: skip

_PATTERNS = tuple(
    map(
        re.compile,
        (
            r"\s*(?P<figure>\S.*?)[ :]+(?P<value>-?\d[\d.]*(?: in 10 000| %| MB| ms| s| times)?)\s*"
            r"\(goal: (?P<goal>[^)]*)\)",
            r"(?P<figure>\S.*?)(?:\s+n +(?P<n>\d+)\s+bias|: bias).*?"
            r"(?P<value>ratio +[\d.]+,? +cover +[^(]*\([^)]*\)).*",
            r"\s*(?P<figure>(?:\S.*)?\bratio\b.*?)[ :]+(?P<value>\d[\d.]*)",
            r"(?P<figure>[^:|]+): (?P<value>\d+ cases, .*)",
            r"=*\s*(?P<value>\d+ (?:passed|failed|skipped)\b.*) in [\d.]+s.*",
            r"\| (?P<row>[^|]+) \| (?P<number>[^|]+) \| (?P<n>\d+) \|.*\| (?P<value>\d+ % \([^)]*\)) \|.*",
        ),
    )
)


def figures(output: str) -> Iterator[tuple[str, str]]:
    """Yield the name and value of each figure in a command's output, with the goal after the value."""
    for line in output.splitlines():
        shown = line.lstrip(".")  # dots of the tests that passed before
        found = next(filter(None, (pattern.fullmatch(shown) for pattern in _PATTERNS)), None)
        if found is not None:
            got: dict[str, str] = {"figure": "tests", "goal": "", "n": ""}
            got |= {name: text for name, text in found.groupdict().items() if text is not None}
            name = f"{got['row']}, {got['number']}" if "row" in got else got["figure"]
            value = " ".join(got["value"].split())
            yield (
                f"{name}, n = {got['n']}" if got["n"] else name,
                f"{value} (goal: {got['goal']})" if got["goal"] else value,
            )


def lines_of(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a file of results, none if it does not exist."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


class Started:
    """A running command of the project, in a separate session, with its output in a log in the folder."""

    def __init__(self, command: str, folder: Path) -> None:
        self.command = command
        words = [word.replace("{folder}", str(folder)) for word in shlex.split(command)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # it would include the compilation of modules in each start
        while "=" in words[0]:
            name, _, value = words.pop(0).partition("=")
            environment[name] = value
        programs = {"python": [sys.executable], "pytest": [sys.executable, "-m", "pytest"]}
        words[:1] = programs.get(words[0], words[:1])
        self._load, self._began_s = round(os.getloadavg()[0], 1), time.monotonic()
        self._log = folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', command)[:120]}.log"
        with self._log.open("w", encoding="utf-8") as file:
            self._process = subprocess.Popen(
                words, cwd=ROOT, env=environment, stdout=file, stderr=subprocess.STDOUT, start_new_session=True
            )
        if _runs_against_a_clock(command):
            # Linux weighs whole sessions against each other; priorities that tests set count only within their session.
            with suppress(OSError):  # raised on other systems, and for users without the right
                Path(f"/proc/{self._process.pid}/autogroup").write_text(_AHEAD, encoding="ascii")

    def code(self, end_s: float) -> str:
        """Return how the command ended, "" while it runs; end a command that runs beyond `end_s`."""
        code = self._process.poll()
        if code is None and time.monotonic() > end_s:
            self.end()
            return TIME_LIMIT
        return "" if code is None else str(code)

    def end(self) -> None:
        """End the command and the programs that it started."""
        os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait()

    def lines(self, code: str) -> list[Line]:
        """Return the command's figures, and how it ended."""
        found = [*figures(self._log.read_text(encoding="utf-8", errors="replace")), (ENDED, code)]
        took_s = round(time.monotonic() - self._began_s)
        facts = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "load": self._load, "took_s": took_s}
        return [{"command": self.command, "figure": name, "value": value, **facts} for name, value in found]


def _runs_against_a_clock(command: str) -> bool:
    return any(name in command for name in WORKERS)


def _can_begin(command: str, running: Sequence[Started]) -> bool:
    """Return whether a command can run in parallel with those that run."""
    return not (_runs_against_a_clock(command) and any(_runs_against_a_clock(one.command) for one in running))


def run_stage(name: str, folder: Path, *, small: bool) -> None:
    """Run the commands that a stage lacks, and store their lines as they end; start none after the stage's time."""
    stage, results = STAGES[name], folder / "results.jsonl"
    size = stage.small if small else stage.size
    done = {line["command"] for line in lines_of(results) if line["figure"] == ENDED}
    lacking = [one for one in (text.replace("{size}", size) for text in stage.commands) if one not in done]
    lacking.sort(key=lambda command: not command.endswith(LONGEST))  # a long command that starts last would run alone
    end_s = time.monotonic() + 60 * stage.minutes
    running: list[Started] = []
    with results.open("a", encoding="utf-8") as file:
        try:
            while running or (lacking and time.monotonic() < end_s):
                can_begin = [one for one in lacking if _can_begin(one, running)]
                if can_begin and len(running) < stage.at_once and time.monotonic() < end_s:
                    lacking.remove(can_begin[0])
                    running.append(Started(can_begin[0], folder))
                time.sleep(_LOOK_S)
                if _asked_to_end.is_set():  # checked here, where all started commands are known
                    raise KeyboardInterrupt
                for one in list(running):
                    if code := one.code(end_s):
                        running.remove(one)
                        lines = one.lines(code) if code != TIME_LIMIT else []
                        file.writelines(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)
                        file.flush()
                        print(f"{name}: {one.command}: {code}", flush=True)
        finally:
            for one in running:
                one.end()
    for command in lacking:
        print(f"{name}: {command}: left for the next start", flush=True)


def main() -> None:
    """Run the commands that the folder lacks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of results, continued")
    parser.add_argument("--small", action="store_true", help="the smallest sizes")
    parser.add_argument("--stage", choices=STAGES, help="only this stage")
    arguments = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):  # a program in the background would ignore the first
        signal.signal(number, lambda *_: _asked_to_end.set())
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        for name in STAGES if arguments.stage is None else [arguments.stage]:
            run_stage(name, folder, small=arguments.small)
    except KeyboardInterrupt:
        sys.exit("ended, with the commands that ran; the same words continue this night")


if __name__ == "__main__":
    main()
