"""What others do to a campaign's folder while cfid writes there: planted links, removed runs, lines of their own."""

import os
import shutil
import stat
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.records.files import write_whole
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import RunWriter, create_run

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and files without a name of Unix")


def new(folder: Path) -> RunWriter:
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))}
    return create_run(folder, kind="swing", label=Label(), devices=devices, started=datetime.now(UTC), cfid_version="0")


def test_a_run_that_is_removed_while_it_is_recorded_ends_with_the_next_rows(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0], [7]))
    shutil.rmtree(writer.folder)

    with pytest.raises(DataError, match=r"encoder\.csv: was removed during the recording, with its 1 rows"):
        writer.append("encoder", ([2.0], [8]))
    with pytest.raises(DataError, match=r"run\.toml: cannot be written"):
        writer.close("failed")


def test_rows_are_appended_to_what_another_program_wrote_meanwhile(tmp_path: Path) -> None:
    with new(tmp_path) as writer:
        path = writer.folder / "encoder.csv"
        writer.append("encoder", ([1.0], [7]))
        with path.open("a") as file:
            file.write("1.500000,9\n")
        writer.append("encoder", ([2.0], [8]))

    assert path.read_text() == "t,phi\n1.000000,7\n1.500000,9\n2.000000,8\n"


def test_a_file_is_written_beside_a_planted_link_and_not_through_it(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    path = tmp_path / "parameters.toml"
    for name in (f".parameters.toml.{os.getpid()}.tmp", ".parameters.toml.tmp"):
        (tmp_path / name).symlink_to(victim)
    write_whole(path, b"new")

    assert victim.read_text() == "mine"
    assert path.read_text() == "new"
    assert not path.is_symlink()


def test_a_file_that_was_replaced_keeps_its_permissions_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text("old")
    path.chmod(0o640)
    write_whole(path, b"new")

    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [each.name for each in tmp_path.iterdir()] == ["parameters.toml"]


def test_a_pipe_is_not_replaced_by_a_file_of_its_name(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(OSError, match="a pipe or a device, where a file is expected"):
        write_whole(tmp_path / "pipe", b"content")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
