"""A report replaces only an unchanged report of cfid, unless it is forced."""

import os
from pathlib import Path

import pytest

from cfid.errors import ConfigError
from cfid.report.formats.sealed import MARK, write_report

TEXT = f"<!-- {MARK} -->\nwhat was measured\n"


def test_a_report_that_cfid_made_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "report.md"
    write_report(path, TEXT)
    write_report(path, TEXT + "more\n")

    assert path.read_text().endswith("more\n")


def test_equal_reports_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.md", "b.md"):
        write_report(tmp_path / name, TEXT)

    assert (tmp_path / "a.md").read_bytes() == (tmp_path / "b.md").read_bytes()


@pytest.mark.parametrize("content", ["mine\n", "", f"<!-- {MARK} -->\nwhat was measured\n"])
def test_what_somebody_else_wrote_stays(tmp_path: Path, content: str) -> None:
    path = tmp_path / "report.md"
    path.write_text(content)

    with pytest.raises(ConfigError, match="not an unchanged report of cfid"):
        write_report(path, TEXT)
    assert path.read_text() == content


def test_a_report_that_somebody_edited_stays(tmp_path: Path) -> None:
    path = tmp_path / "report.md"
    write_report(path, TEXT)
    path.write_text(path.read_text() + "my remark\n")

    with pytest.raises(ConfigError, match="`force`"):
        write_report(path, TEXT)
    write_report(path, TEXT, force=True)
    assert "remark" not in path.read_text()


def test_a_folder_is_made_and_one_that_cannot_be_is_told(tmp_path: Path) -> None:
    write_report(tmp_path / "new" / "report.md", TEXT)
    (tmp_path / "file").write_text("")

    with pytest.raises(ConfigError, match="no report can be written"):
        write_report(tmp_path / "file" / "report.md", TEXT)
    with pytest.raises(ConfigError, match="no report can be written"):
        write_report(tmp_path / "new", TEXT)


def test_a_name_that_is_no_utf_8_does_not_hinder_a_report(tmp_path: Path) -> None:
    write_report(tmp_path / "a.md", TEXT + "campaign \udcff\n")

    assert (tmp_path / "a.md").read_text().endswith("campaign ?\n")


@pytest.mark.skipif(os.name != "posix", reason="pipes of Unix")
@pytest.mark.parametrize("force", [False, True])
def test_a_pipe_of_that_name_is_neither_waited_for_nor_replaced(tmp_path: Path, *, force: bool) -> None:
    path = tmp_path / "report.md"
    os.mkfifo(path)

    with pytest.raises(ConfigError, match="no report can be written there: a pipe or a device"):
        write_report(path, TEXT, force=force)
    assert path.is_fifo()
