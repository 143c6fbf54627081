"""Other programs change a campaign's folder while cfid writes there: planted links, removed runs, added lines."""

import os
import shutil
import stat
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.records.files import write_whole
from cfid.records.fits import keep_fit, list_fits
from cfid.records.parameters import Section, Source
from cfid.records.rig_file import thesis_rig
from cfid.records.run import DeviceRecord, Label, read_run
from cfid.records.run_writer import RunWriter, create_run
from cfid.records.stale import stale_in
from tests.records.test_fits import FIT

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and files without a name of Unix")


NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)


def new(folder: Path, started: datetime | None = None) -> RunWriter:
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))}
    when = started or datetime.now(UTC)
    return create_run(folder, kind="swing", label=Label(), devices=devices, started=when, cfid_version="0")


def test_a_run_that_is_removed_while_it_is_recorded_ends_with_the_next_rows(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0], [7]))
    shutil.rmtree(writer.folder)

    with pytest.raises(DataError, match=r"encoder\.csv.* 1 row"):
        writer.append("encoder", ([2.0], [8]))
    with pytest.raises(DataError, match=r"run\.toml"):
        writer.close("failed")


@pytest.mark.parametrize("replaced", [False, True])
def test_a_run_that_is_moved_while_it_is_recorded_ends_and_its_rows_are_where_it_went(
    tmp_path: Path, replaced: bool
) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0], [7]))
    moved = writer.folder.rename(tmp_path / "moved")
    if replaced:
        writer.folder.mkdir()

    with pytest.raises(DataError, match=r"encoder\.csv.* 1 row"):
        writer.append("encoder", ([2.0], [8]))
    with pytest.raises(DataError, match=r"run\.toml"):
        writer.close("failed")

    assert (moved / "encoder.csv").read_text() == "t,phi\n1.000000,7\n"
    assert read_run(moved).header.state == "recording"
    assert not replaced or not list(writer.folder.iterdir())


def test_a_file_that_another_program_cuts_ends_the_recording(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0, 2.0], [7, 8]))
    os.truncate(writer.folder / "encoder.csv", 8)

    with pytest.raises(DataError, match=r"was cut by another program during the recording, with its 2 rows"):
        writer.append("encoder", ([3.0], [9]))
    assert writer.close("complete").header.state == "failed"


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


def test_a_pipe_is_not_replaced_by_a_file_of_its_name(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(OSError, match="a pipe or a device, where a file is expected"):
        write_whole(tmp_path / "pipe", b"content")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_a_pipe_among_fits_sources_or_lists_is_not_waited_for(tmp_path: Path) -> None:
    fits, pipe = tmp_path / "fits", tmp_path / "pipe"  # reading a pipe would wait for a writer
    keep_fit(fits, FIT)
    os.mkfifo(fits / "2026-11-21_083013_inertia.json")
    os.mkfifo(pipe)
    whole, broken = list_fits(fits)
    section = Section(
        method="m", found=datetime.now(UTC), cfid_version="0", accepted=True, parameters={},
        sources=(Source("pipe", "0" * 64), Source("/dev/zero", "0" * 64)),
    )  # fmt: skip

    assert not isinstance(whole, DataError)
    assert isinstance(broken, DataError)
    assert stale_in(tmp_path, (), thesis_rig())(section) == ()
