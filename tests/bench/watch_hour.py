"""The time of a picture of `cfid watch` in an hour's run at 7 kHz, which must not grow as more is recorded.

The rows are in a run folder as a recorder writes them, but written all at once. The time of a picture is that of
reading a tenth of a second of new rows, and of computing the curves of forces and torques in each span.
"""

import resource
import statistics
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import numpy as np

from cfid.recordings.wrench import AXES, LOADCELL
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.watch.live_run import LiveRun
from cfid.watch.picture import BINS

RATE_HZ = 7000
MARKS_MIN = (1, 10, 60)
PICTURES = 50
SPANS_S = {"10 s": 10.0, "60 s": 60.0, "all": float("inf")}
FILE = "loadcell.csv"


class Recorder:
    """Append rows to the file of a run, with forces and torques that repeat each second."""

    def __init__(self, file: BinaryIO) -> None:
        counts = np.random.default_rng(1).integers(-90_000, 90_000, (RATE_HZ, len(AXES)))
        self._file, self._row = file, 0
        self._values = [b"".join(b",%d" % value for value in row) + b"\n" for row in counts]

    def write(self, rows: int) -> None:
        numbers = range(self._row, self._row + rows)
        self._row += rows
        self._file.write(b"".join(b"%.6f%s" % (1.7e9 + k / RATE_HZ, self._values[k % RATE_HZ]) for k in numbers))
        self._file.flush()


def main() -> None:
    """Let a run grow, and print the times at each mark."""
    first_ms, taken_ms, minutes = dict[str, float](), dict[str, float](), 0
    with tempfile.TemporaryDirectory() as folder, (open_run(Path(folder)) / FILE).open("ab") as file:
        run, recorder = LiveRun(Path(file.name).parent), Recorder(file)
        for mark in MARKS_MIN:
            for _ in range(60 * (mark - minutes)):
                recorder.write(RATE_HZ)
                run.read(60.0)
            minutes = mark
            taken_ms = picture_ms(run, recorder)
            first_ms = first_ms or taken_ms
            memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            words = ", ".join(f"{span} {ms:.1f} ms" for span, ms in taken_ms.items())
            print(f"after {mark:2d} min: a picture of {words}; {memory_mb:.0f} MB of memory", flush=True)
    grown = max(taken_ms[span] / first_ms[span] for span in SPANS_S)
    print(f"at the end against the first minute: ratio {grown:.2f} (goal: below 1.5)")


def open_run(folder: Path) -> Path:
    """Start the run of a load cell, and return its folder."""
    record = DeviceRecord.model_validate({"file": FILE, "columns": ("t", *AXES), "rate_hz": RATE_HZ})
    devices, started = {LOADCELL: record}, datetime.now(UTC)
    writer = create_run(folder, kind="loadcell", label=Label(), devices=devices, started=started, cfid_version="0")
    return writer.folder


def picture_ms(run: LiveRun, recorder: Recorder) -> dict[str, float]:
    """Return the median processor time of a picture for each span, in ms."""
    taken = {span: list[float]() for span in SPANS_S}
    for _ in range(PICTURES):
        recorder.write(RATE_HZ // 10)
        begin_s = time.process_time()
        run.read(1.0)
        read_s = time.process_time() - begin_s
        for span, length_s in SPANS_S.items():
            begin_s = time.process_time()
            for signal in run.signals:
                signal.extremes.view(max(run.now_s - length_s, 0.0), run.now_s, BINS).zigzag()
            taken[span].append(read_s + time.process_time() - begin_s)
    return {span: 1e3 * statistics.median(each) for span, each in taken.items()}


if __name__ == "__main__":
    main()
