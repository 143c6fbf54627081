"""The progress of a run exists while it is recorded, and never afterwards."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.records.progress import PROGRESS_FILE, Counts, RunProgress, read_progress
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import RunWriter, create_run

PROGRESS = RunProgress(
    left_s=1.5,
    devices={"encoder": Counts(rows=7, lost=2, rate_hz=999.5), "scales": Counts(rows=1, lost=None, rate_hz=0.0)},
)


@pytest.fixture
def writer(tmp_path: Path) -> RunWriter:
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))}
    started = datetime.now(UTC)
    return create_run(tmp_path, kind="swing", label=Label(), devices=devices, started=started, cfid_version="0")


def test_the_counts_are_read_back_until_the_run_is_closed(writer: RunWriter) -> None:
    assert read_progress(writer.folder) == RunProgress()
    writer.sync(PROGRESS)
    assert read_progress(writer.folder) == PROGRESS
    writer.close("complete")
    assert sorted(path.name for path in writer.folder.iterdir()) == ["encoder.csv", "run.toml"]


def test_a_thread_that_writes_while_the_run_is_closed_leaves_no_file(writer: RunWriter) -> None:
    with ThreadPoolExecutor(4) as threads:
        for _ in range(40):
            threads.submit(writer.sync, PROGRESS)
        writer.close("complete")
    assert not (writer.folder / PROGRESS_FILE).exists()


def test_nothing_is_written_into_another_folder_of_the_name(writer: RunWriter, tmp_path: Path) -> None:
    writer.folder.rename(tmp_path / "moved")
    writer.sync(PROGRESS)
    writer.folder.mkdir()
    writer.sync(PROGRESS)
    with pytest.raises(DataError):
        writer.close("failed")
    assert list(writer.folder.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b'{"devices": {"encoder": {"rows": -1, "lost": 0, "rate_hz": 1}}}', b"\xff"])
def test_a_damaged_file_states_nothing(writer: RunWriter, content: bytes) -> None:
    (writer.folder / PROGRESS_FILE).write_bytes(content)
    assert read_progress(writer.folder) == RunProgress()
    writer.close("complete")
