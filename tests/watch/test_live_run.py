"""What a run's folder shows while it grows: rows, curves in their units, counts, state, remaining time, spectrum."""

import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid.records.progress import PROGRESS_FILE, Counts, RunProgress
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import RunWriter, create_run
from cfid.watch.live_run import CHUNK_BYTES, DeviceRows, LiveRun, newest_run
from cfid.watch.page import facts_html
from cfid.wire.rls import encode_positions
from cfid.wire.supervisor import Bits

Recording = Callable[..., RunWriter]


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Recording]:
    """Begin runs of one device each, which end with the test."""
    writers: list[RunWriter] = []

    def begin(
        device: str,
        *columns: str,
        note: str | None = None,
        kind: str = "thrust",
        **facts: object,
    ) -> RunWriter:
        record = DeviceRecord.model_validate({"file": f"{device}.csv", "columns": ("t", *columns), **facts})
        writers.append(
            create_run(
                tmp_path,
                kind=kind,
                label=Label(note=note),
                devices={device: record},
                started=datetime.now(UTC),
                cfid_version="0",
            )
        )
        return writers[-1]

    yield begin
    for writer in writers:
        if writer.header.state == "recording":
            writer.close("complete")


def read(folder: Path) -> LiveRun:
    run = LiveRun(folder)
    run.read(1.0)
    run.read(1.0)
    return run


# Rows


def rows_of(path: Path, columns: int) -> DeviceRows:
    names = tuple("tabcdefg"[:columns])
    return DeviceRows(path=path, record=DeviceRecord(file=path.name, columns=names), signals=[])


def test_each_row_is_read_once_and_a_cut_line_waits_for_its_end(tmp_path: Path) -> None:
    device = rows_of(tmp_path / "x.csv", 3)
    assert device.read().shape == (0, 3)  # before the file exists
    with device.path.open("ab", buffering=0) as file:
        file.write(b"t,a,b\n1.5,2,3\n2.5,")
        assert device.read().tolist() == [[1.5, 2.0, 3.0]]
        assert device.read().shape == (0, 3)
        file.write(b"33,\n3.5,4,5\n")
        assert np.array_equal(device.read(), [[2.5, 33.0, np.nan], [3.5, 4.0, 5.0]], equal_nan=True)
    device.path.unlink()
    assert device.read().shape == (0, 3)


def test_a_long_file_is_read_in_chunks_that_miss_no_row_and_count_what_is_none(tmp_path: Path) -> None:
    device, count, parts = rows_of(tmp_path / "x.csv", 2), 3 * CHUNK_BYTES // 12, list[np.ndarray]()
    device.path.write_text("t,a\n" + "".join(f"{i}.25,{i}\n" for i in range(count)))
    while len(rows := device.read()):
        parts.append(rows)
    assert len(parts) > 1
    assert np.array_equal(np.concatenate(parts)[:, 1], np.arange(count))

    for text, rows_read in (("1,two\n", 0), ("2,3\n", 1)):
        with device.path.open("a") as file:
            file.write(text)
        assert len(device.read()) == rows_read
    assert device.unreadable == len("1,two\n")


# Facts


def test_counts_are_the_recorders_and_then_those_of_run_toml(recording: Recording) -> None:
    writer = recording("loadcell", "Fx", rate_hz=1000)
    run = LiveRun(writer.folder)
    assert run.progress() == RunProgress()
    progress = RunProgress(left_s=80.4, devices={"loadcell": Counts(rows=1200, lost=3, rate_hz=998.7)})
    writer.sync(progress)
    assert run.progress() == progress
    assert "1:20 min left" in facts_html(run, refused=0)
    assert ">999 of 1000 Hz, 1200 rows, 3 lost<" in facts_html(run, refused=0)

    writer.append("loadcell", ([time.time()], [0]))
    writer.count_lost("loadcell", 5)
    writer.close("failed", reason="the box went silent")
    run.read_header()
    assert run.progress() == RunProgress(devices={"loadcell": Counts(rows=1, lost=5, rate_hz=0.0)})
    assert ">1 row, 5 lost<" in facts_html(run, refused=0)


def test_a_recorder_that_hangs_is_told_from_one_that_is_gone(recording: Recording, tmp_path: Path) -> None:
    writer = recording("supervisor", "info")
    writer.append("supervisor", (time.time() - 60 + np.array([0.0, 10.0]), np.array([Bits.FLYING] * 2)))
    writer.sync(RunProgress(left_s=9.0, devices={"supervisor": Counts(rows=2, lost=0, rate_hz=100.0)}))
    os.utime(writer.folder / "supervisor.csv", (0, 0))
    os.utime(writer.folder / PROGRESS_FILE, (0, time.time() - 50))
    hangs, gone = read(writer.folder), read(shutil.copytree(writer.folder, tmp_path / "copied"))

    assert [(run.silent, run.recording_now) for run in (hangs, gone)] == [(True, True), (True, False)]
    assert hangs.quiet_s == pytest.approx(50.0, abs=2.0)
    for shown in (facts_html(run, refused=0) for run in (hangs, gone)):
        assert "2 rows, 0 lost" in shown
        assert " Hz" not in shown
        assert "left" not in shown


def test_the_newest_run_is_the_one_that_is_recorded_else_the_last(recording: Recording, tmp_path: Path) -> None:
    assert newest_run(tmp_path) is None
    first, second = recording("encoder", "phi"), recording("encoder", "phi")
    second.close("complete")
    os.utime(first.folder / "encoder.csv", (0, 0))  # it waits for its device
    assert newest_run(tmp_path) == first.folder
    first.close("complete")
    assert newest_run(tmp_path) == second.folder


# Curves


def test_an_angle_goes_on_over_the_end_of_a_turn_without_words_that_fail_their_check(recording: Recording) -> None:
    writer = recording("encoder", "phi", counts_per_turn="rls-13bit-in-22")
    run = LiveRun(writer.folder)
    words = encode_positions(np.arange(8000, 8000 + 1000) % 8192)
    words[100] ^= 1
    for part in np.array_split(np.arange(1000), 7):
        writer.append("encoder", (1000.0 + part / 1000, words[part]))
        run.read(1.0)

    angle = run.signals[0].extremes.view(0.0, 1.0, 2000).low[:, 0]
    assert math.isnan(angle[100])
    assert np.nanmax(angle) - np.nanmin(angle) == pytest.approx(360 * 999 / 8192)
