"""Refit many campaigns: with 1 and 2 processes, on a cluster with a worker killed, and against `cfid fit` alone.

Each campaign has swings, dropped weights and a test body, with three fits. Some are simulated, with different seeds;
the others are copies of them. Numbers have to be the same to the last bit. BENCH_CAMPAIGNS sets how many there are
(200), BENCH_SEEDS how many are simulated (4), and BENCH_FITS which fits each has; with only `swing`, campaigns have one
run.

Goal: at most 1.2 times the processor time per campaign of the same fits by commands in one process that has imported
all modules.
"""

import contextlib
import ctypes
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from cfid.cli.main import main as cfid
from cfid.console.campaign import make_campaign
from cfid.fleet.refit import refit
from cfid.records.campaign import open_campaign
from cfid.records.parameters import plain
from cfid.sim.truth import USUAL_TRUTH
from tests.lab import sections_at
from tests.offline.swings import record_chapter_2
from tests.offline.write import write_runs

CAMPAIGNS = int(os.environ.get("BENCH_CAMPAIGNS", "200"))
SEEDS = int(os.environ.get("BENCH_SEEDS", "4"))
FITS = tuple(os.environ.get("BENCH_FITS", "inertia,friction,testbody").split(","))
WARM_ROUNDS = 7
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER: this process inherits the fork server of a command that ends
ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def run(*words: object) -> float:
    """Run cfid; return the seconds that it took."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "cfid.cli.main", *map(str, words)]
    subprocess.run(command, check=True, env=ONE_THREAD, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - began_s


def run_counted(*words: object) -> tuple[float, float]:
    """Run cfid; return its seconds by the wall clock and of processor time, including that of its own processes."""
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    others, before = _children(), resource.getrusage(resource.RUSAGE_CHILDREN)
    took_s = run(*words)
    while left := _children() - others:
        os.waitpid(left.pop(), 0)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return took_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _children() -> set[int]:
    """Return the children of this process, including those that a command left to it, such as its fork server."""
    return {int(pid) for path in Path("/proc/self/task").glob("*/children") for pid in path.read_text().split()}


def words_of(fit: str, place: Path) -> list[str]:
    return ["fit", fit, *(["last"] if fit == "swing" else []), "--no-figures", "--campaign", str(place)]


def warm_rounds(place: Path) -> None:
    """Fit and refit a campaign in turns in this process; print the processor time of both in each round."""
    for _ in range(WARM_ROUNDS):
        began_s = time.process_time()
        for fit in FITS:
            with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
                cfid(words_of(fit, place))
        fitted_s = time.process_time()
        refit(str(place))
        print(fitted_s - began_s, time.process_time() - fitted_s)


def warm_s(place: Path) -> tuple[float, float]:
    """Return medians of the processor time of a campaign's fits in a warm process, and of a refit's ratio to it."""
    command = [sys.executable, "-m", "tests.bench.fleet", str(place)]
    ended = subprocess.run(command, check=True, env=ONE_THREAD, capture_output=True, text=True)
    fitted_s, again_s = np.array(ended.stdout.split(), dtype=np.float64).reshape(-1, 2)[1:].T
    return float(np.median(fitted_s)), float(np.median(again_s / fitted_s))


def make_campaigns(folder: Path) -> float:
    """Make the campaigns; return the processor time that the fits of one campaign take as separate commands."""
    spent_s = []
    for number in range(min(SEEDS, CAMPAIGNS)):
        place = folder / f"c{number:03}"
        make_campaign(place)
        campaign = open_campaign(place)
        runs, _ = record_chapter_2(campaign.rig, USUAL_TRUTH, np.random.default_rng(number))
        write_runs(campaign, runs[:1] if FITS == ("swing",) else runs)
        spent_s.append(sum(run_counted(*words_of(name, place))[1] for name in FITS))
    for number in range(len(spent_s), CAMPAIGNS):
        shutil.copytree(folder / f"c{number % SEEDS:03}", folder / f"c{number:03}")
    return float(np.median(spent_s))


def numbers(folder: Path) -> dict[str, Any]:
    """Return all numbers of refitted campaigns, to the last bit."""
    return {
        f"{each.name} {name} {key}": (plain(one.value), plain(one.std))
        for each in sorted(folder.iterdir())
        if each.is_dir()
        for name, section in sections_at(each).items()
        for key, one in section.parameters.items()
    }


def of_workers_s(folder: Path) -> float:
    """Return the median processor time that a worker took for a campaign, as the manifest states it."""
    rows = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()[1:]]
    return float(np.median([row["processor_s"] for row in rows]))


def on_cluster(folder: Path, out: Path) -> float:
    """Refit on a cluster of two workers, one of which is killed after a third of the campaigns; return the seconds."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        victim = cluster.workers[0].pid

        def kill() -> None:
            while not out.is_dir() or len(list(out.iterdir())) < CAMPAIGNS / 3:
                time.sleep(0.05)
            os.kill(victim, signal.SIGKILL)
            print(f"  worker {victim} killed")

        threading.Thread(target=kill, daemon=True).start()
        return run("fleet", "fit", folder / "c*", "--out", out, "--scheduler", cluster.scheduler_address)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "all").mkdir()
        alone_s = make_campaigns(place / "all")
        print(
            f"{CAMPAIGNS} campaigns of {len(FITS)} fits; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
        )
        once_s, times = warm_s(place / "all" / "c000")
        print(f"cfid fit, {len(FITS)} commands a campaign: {alone_s:.3f} s of processor time with the start of Python,")
        print(f"  {once_s:.3f} s in one process that has imported all; refitted there in turns")
        print(f"ratio of a refit to the fits: {times:.2f} (goal: at most 1.2)")
        found = {}
        for jobs in (1, 2):
            wall_s, spent_s = run_counted(
                "fleet", "fit", place / "all" / "c*", "--out", place / f"{jobs}", "--jobs", jobs
            )
            found[f"{jobs} processes"] = numbers(place / f"{jobs}")
            each_s = spent_s / CAMPAIGNS
            print(
                f"{jobs} processes: {wall_s:.1f} s; {each_s:.3f} s of processor time a campaign with all that starts, "
                f"{each_s / once_s:.2f} times cfid fit; a worker {of_workers_s(place / str(jobs)) / once_s:.2f} times"
            )
        wall_s = on_cluster(place / "all", place / "cluster")
        times = of_workers_s(place / "cluster") / once_s
        print(f"cluster of 2 workers: {wall_s:.1f} s; a worker {times:.2f} times cfid fit")
        found["cluster"] = numbers(place / "cluster")
        kept = numbers(place / "all")
        for workers, each in found.items():
            print(f"{workers}: {len(each)} numbers and uncertainties, the same as kept: {each == kept}")
        wall_s = run("fleet", place / "1" / "c*", "--out", place / "table.csv")
        print(f"cfid fleet compares them in {wall_s:.1f} s")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        warm_rounds(Path(sys.argv[1]))
    else:
        main()
