"""`--out` to a place where no file can be written gives a message with exit code 2, and changes nothing there."""

import os
from pathlib import Path

import pytest

from cfid.errors import ConfigError
from cfid.records.rig_file import new_rig_text
from cfid.report.sealed import write_report
from tests.export.thesis_vehicle import sections
from tests.lab import Cfid, keep

ODD = (
    "folder",
    "/",
    "..",
    "/dev/null",
    "pipe",
    "n" * 300,
    f"{'n' * 300}/file",
    "mine/file",
    "loop",
    "loop/file",
    "/proc/x",
)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with the thesis' numbers, together with a folder, a foreign file, a link to itself and a pipe."""
    (tmp_path / "rig.toml").write_text(new_rig_text())
    for name, found in sections().items():
        keep(tmp_path, name, found)
    (tmp_path / "folder").mkdir()
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes | None]:
    return {path.name: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.skipif(os.name != "posix", reason="names and devices of Unix")
def test_nothing_is_written_where_no_file_can_be(cfid: Cfid, campaign: Path) -> None:
    before = contents(campaign)
    for place in ODD:
        for more in ((), ("--force",)):
            ended = cfid("export", "crazyflow", "--out", place, *more)
            assert ended.returncode == 2, place
            assert ended.stderr.startswith(f"cfid: {place}")
            with pytest.raises(ConfigError) as refused:
                write_report(campaign / place, "a report", force=bool(more))
            assert str(refused.value).startswith(str(campaign / place))

    assert contents(campaign) == before


@pytest.mark.parametrize("command", ["export samples", "report"])
def test_a_name_that_no_file_can_have_is_a_sentence(command: str, cfid: Cfid, campaign: Path) -> None:
    ended = cfid(*command.split(), "--out", "n" * 300)

    assert ended.returncode == 2
    assert "File name too long" in ended.stderr


def test_the_longest_name_that_a_file_can_have_is_written(cfid: Cfid, campaign: Path) -> None:
    name = f"{'ü' * 125}.toml"  # 255 bytes
    ended = cfid("export", "crazyflow", "--out", name)

    assert ended.returncode == 0, ended.stderr
    assert (campaign / name).stat().st_size > 0
