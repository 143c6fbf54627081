"""A run folder is made once, appended to, closed and read; it is never overwritten, and it reports what it lacks."""

import os
import re
import shutil
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from cfid.errors import ConfigError, DataError
from cfid.recordings.angle import angle_record
from cfid.records.files import write_whole
from cfid.records.fits import keep_fit, list_fits
from cfid.records.parameters import Source
from cfid.records.progress import PROGRESS_FILE, Counts, RunProgress, read_progress
from cfid.records.rig_file import thesis_rig
from cfid.records.run import DeviceRecord, Label, Run, list_runs, losses, read_run
from cfid.records.run_writer import RunWriter, create_run
from cfid.records.stale import stale_in
from cfid.wire.rls import encode_positions
from tests.lab import STARTED_S, made_run
from tests.records.test_fits import FIT

STARTED = datetime(2026, 11, 21, 8, 30, 12, 345678, tzinfo=UTC)
ENCODER = DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn="rls-13bit-in-22")
EPOCH_S = 1_763_712_345.0
TIME_S = EPOCH_S + np.arange(100) * 1e-3
COUNTS = encode_positions(np.arange(100))


def new(folder: Path, **changes: Any) -> RunWriter:
    settings: dict[str, Any] = {
        "kind": "swing",
        "label": Label(axis="x"),
        "devices": {"encoder": ENCODER},
        "started": STARTED,
        "cfid_version": "0.1.0",
    }
    return create_run(folder / "runs", **(settings | changes))


def recorded(folder: Path, rows: int = 100, **changes: Any) -> Path:
    with new(folder, **changes) as writer:
        writer.append("encoder", (TIME_S[:rows], COUNTS[:rows]))
    return writer.folder


def header_of(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "run.toml").read_text())


def changed(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    content = header_of(folder)
    change(content)
    (folder / "run.toml").write_bytes(tomli_w.dumps(content).encode())
    return folder


# Recording


def test_a_run_is_recorded_in_blocks_and_read_back(tmp_path: Path) -> None:
    with new(tmp_path) as writer:
        for begin in range(0, 100, 7):
            writer.append("encoder", (TIME_S[begin : begin + 7], COUNTS[begin : begin + 7]))
        writer.append("encoder", ([], []))
    assert writer.folder == tmp_path / "runs" / "2026-11-21_083012_swing_x"
    assert sorted(path.name for path in writer.folder.iterdir()) == ["encoder.csv", "run.toml"]
    lines = (writer.folder / "encoder.csv").read_bytes().decode().split("\n")
    assert lines[:3] == ["t,phi", "1763712345.000000,0", "1763712345.001000,512"]
    assert lines[-2:] == ["1763712345.099000,50691", ""]

    run = read_run(writer.folder)
    assert run == Run(folder=writer.folder, header=writer.header)
    assert (run.header.state, run.header.reason, run.cut) == ("complete", "", False)
    assert run.header.devices["encoder"].rows == 100
    assert run.header.started == STARTED
    record = angle_record(writer.folder)
    assert record.time_s == pytest.approx(TIME_S - EPOCH_S, abs=1e-6)
    assert record.angle_rad == pytest.approx(np.arange(100) * 2 * np.pi / 8192)
    assert record.label == Label(axis="x")
    assert record.notes == ()


def test_raw_values_are_written_exactly(tmp_path: Path) -> None:
    values = [0.1, 1e-300, -5.0, 2**53 + 2, 1 / 3, -(2**31)]
    column = np.array(values, dtype=object)
    with new(tmp_path) as writer:
        writer.append("encoder", (np.arange(len(values)), column))
        writer.append("encoder", ([7.0], np.array([0.1], dtype=np.float32)))
        writer.append("encoder", ([8.0], np.array([4294967295], dtype=np.uint32)))
    rows = (writer.folder / "encoder.csv").read_text().splitlines()[1:]
    assert [float(row.split(",")[1]) for row in rows] == [*values, float(np.float32(0.1)), 4294967295.0]
    assert rows[3] == "3.000000,9007199254740994"


def test_the_folder_is_named_after_what_the_operator_said(tmp_path: Path) -> None:
    stem = "2026-11-21_083012"
    assert recorded(tmp_path, label=Label(body="testbody", axis="z")).name == f"{stem}_swing_testbody_z"
    assert recorded(tmp_path, label=Label(body="crazyflie", axis="z")).name == f"{stem}_swing_z"
    assert recorded(tmp_path, kind="drop", label=Label(weight_g=20)).name == f"{stem}_drop_20g"
    assert recorded(tmp_path, kind="drop", label=Label(weight_g=2.5)).name == f"{stem}_drop_2.5g"
    assert recorded(tmp_path, label=Label()).name == f"{stem}_swing"


@pytest.mark.parametrize("axis", ["../../outside", "/etc", "a b\nc", "ü", "CON:"])
def test_no_label_leads_out_of_the_runs_folder(tmp_path: Path, axis: str) -> None:
    folder = recorded(tmp_path, label=Label(axis=axis))
    assert folder.parent == tmp_path / "runs"
    assert read_run(folder).header.label.axis == axis
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
    assert len(list_runs(tmp_path / "runs")) == 1


def test_nothing_that_is_there_is_touched(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "2026-11-21_083012_swing_x"
    folder.mkdir(parents=True)
    (folder / "encoder.csv").write_text("mine")
    (tmp_path / "runs" / "2026-11-21_083012_swing_x-2").symlink_to("nowhere")
    assert recorded(tmp_path).name == "2026-11-21_083012_swing_x-3"
    assert [path.read_text() for path in folder.iterdir()] == ["mine"]


def test_a_block_that_does_not_fit_the_columns_is_a_bug_and_writes_nothing(tmp_path: Path) -> None:
    with new(tmp_path) as writer:
        for columns in ([TIME_S], [TIME_S, COUNTS, COUNTS], [TIME_S, COUNTS[:5]], [[float("nan")], [1]]):
            with pytest.raises(ValueError):
                writer.append("encoder", columns)
        with pytest.raises(KeyError):
            writer.append("loadcell", (TIME_S, COUNTS))
    assert (writer.folder / "encoder.csv").read_text() == "t,phi\n"


# Ends of runs


def test_ctrl_c_closes_the_run_as_interrupted_with_all_rows(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", (TIME_S, COUNTS))
    with pytest.raises(KeyboardInterrupt), writer:
        raise KeyboardInterrupt
    run = read_run(writer.folder)
    assert (run.header.state, run.header.devices["encoder"].rows) == ("interrupted", 100)
    assert angle_record(writer.folder).notes == ()


def test_an_error_closes_the_run_as_failed_with_its_reason_and_its_losses(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", (TIME_S, COUNTS))
    writer.count_lost("encoder", 3)
    writer.count_lost("encoder", 4)
    with pytest.raises(RuntimeError), writer:
        raise RuntimeError("cable \udcff pulled\r\nat noon")
    header = read_run(writer.folder).header
    assert header.state == "failed"
    assert header.reason == "cable ? pulled\r\nat noon"
    assert header.devices["encoder"].lost == 7
    notes = angle_record(writer.folder).notes
    assert "the run failed (cable" in notes[0]
    assert "7 samples were lost while recording" in notes[1]


@pytest.mark.parametrize(("lost", "severity"), [(1, "note"), (2, "warning")])
def test_losses_beyond_one_percent_are_a_warning(tmp_path: Path, lost: int, severity: str) -> None:
    with new(tmp_path) as writer:
        writer.append("encoder", (TIME_S, COUNTS))
        writer.count_lost("encoder", lost)
    run = read_run(writer.folder)
    (finding,) = losses(run, run.header.devices["encoder"], rows=100)

    assert (finding.code, finding.severity) == ("samples-lost", severity)


def test_a_run_closed_by_hand_keeps_its_reason_and_takes_no_more(tmp_path: Path) -> None:
    with new(tmp_path) as writer:
        writer.append("encoder", (TIME_S, COUNTS))
        closed = writer.close("interrupted", reason="enough", lost={"encoder": 2})
        with pytest.raises(ValueError, match="takes no more rows"):
            writer.append("encoder", (TIME_S, COUNTS))
        with pytest.raises(ValueError, match="closed already"):
            writer.close("complete")
    assert read_run(writer.folder) == closed
    assert (closed.header.reason, closed.header.devices["encoder"].lost) == ("enough", 2)


@pytest.mark.parametrize("name", ["runs", "."])
def test_a_place_where_no_run_can_be_made_is_a_configuration_error(tmp_path: Path, name: str) -> None:
    (tmp_path / "runs").write_text("a file")
    with pytest.raises(ConfigError, match="cannot be created"):
        new(tmp_path / name)


def test_two_devices_cannot_share_a_file_and_a_run_that_cannot_begin_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        new(tmp_path, devices={"encoder": ENCODER, "other": ENCODER})
    assert list((tmp_path / "runs").iterdir()) == []


# Reading damaged, newer or changed runs


def test_a_run_folder_that_was_cut_at_any_byte_gives_its_first_rows_and_says_so(tmp_path: Path) -> None:
    folder = recorded(tmp_path, rows=20)
    file = folder / "encoder.csv"
    content = file.read_bytes()
    whole = angle_record(folder)
    for length in range(len(content) - 40, len(content)):
        file.write_bytes(content[:length])
        record = angle_record(folder)
        rows = content.count(b"\n", 0, length) - 1
        assert record.angle_rad.tolist() == whole.angle_rad[:rows].tolist()
        assert record.time_s.tolist() == whole.time_s[:rows].tolist()
        assert any(f"20 rows were recorded, but encoder.csv has {rows}" in note for note in record.notes)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: c.pop("kind"), "kind is missing"),
        (lambda c: c.update(state="done"), "state: "),
        (lambda c: c.update(started=datetime(2026, 11, 21, 8)), "started: "),
        (lambda c: c["label"].update(weight_g=-5), "label.weight_g: "),
        (lambda c: c.update(devices=[]), "devices: should be a table"),
        (lambda c: c["devices"]["encoder"].update(file="../../etc/passwd"), "devices.encoder.file: "),
        (lambda c: c["devices"]["encoder"].update(columns=["t,phi"]), "devices.encoder.columns.0: "),
    ],
)
def test_a_damaged_run_is_refused_by_file_and_key(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], expected: str
) -> None:
    folder = changed(recorded(tmp_path), change)
    with pytest.raises(DataError) as caught:
        angle_record(folder)
    assert f"{folder / 'run.toml'}: " in str(caught.value)
    assert expected in str(caught.value)
    assert list_runs(tmp_path / "runs")[0].__class__ is DataError


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe", b"a = " + b"[" * 3000, b"a = " + b"9" * 5000, b'format = 2\nstate = "dreaming"\n']
)
def test_a_run_file_that_is_no_toml_or_newer_is_refused(tmp_path: Path, content: bytes) -> None:
    folder = recorded(tmp_path)
    (folder / "run.toml").write_bytes(content)
    with pytest.raises(DataError, match=re.escape(str(folder / "run.toml"))) as caught:
        read_run(folder)
    assert ("newer cfid" in str(caught.value)) == (b"format" in content)


def test_a_run_file_with_a_byte_order_mark_and_crlf_is_read(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    file = folder / "run.toml"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert read_run(folder).header.devices["encoder"].rows == 100


def test_a_folder_without_a_run_and_a_run_without_its_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"run\.toml"):
        angle_record(tmp_path)
    folder = recorded(tmp_path)
    (folder / "encoder.csv").unlink()
    with pytest.raises(DataError, match=r"encoder\.csv"):
        angle_record(folder)
    (folder / "run.toml").unlink()
    (folder / "run.toml").mkdir()
    with pytest.raises(DataError, match=r"run\.toml"):
        angle_record(folder)


@pytest.mark.parametrize("file", ["../x.csv", "a/b.csv", ".csv", "run.toml", "C:\\x.csv", ".hidden.csv"])
def test_a_device_cannot_be_recorded_outside_of_its_run(file: str) -> None:
    with pytest.raises(ValueError):
        DeviceRecord(file=file, columns=("t", "phi"))


def test_runs_are_numbered_in_the_order_in_which_they_were_recorded_whatever_the_clock_shows(tmp_path: Path) -> None:
    later, earlier = STARTED + timedelta(days=2), STARTED - timedelta(days=2)
    folders = [recorded(tmp_path, started=started) for started in (STARTED, later, earlier)]
    runs = [run for run in list_runs(tmp_path / "runs") if isinstance(run, Run)]

    assert [run.folder for run in runs] == folders
    assert [run.header.number for run in runs] == [1, 2, 3]


def test_runs_without_a_number_come_first_by_their_start(tmp_path: Path) -> None:
    numbered = recorded(tmp_path, started=STARTED - timedelta(days=9))
    old = [recorded(tmp_path, started=STARTED + timedelta(days=day)) for day in (2, 1)]
    for folder in old:
        changed(folder, lambda content: content.pop("number"))

    assert [run.folder for run in list_runs(tmp_path / "runs") if isinstance(run, Run)] == [*reversed(old), numbered]
    assert header_of(recorded(tmp_path))["number"] == 2  # one more than the largest there


def test_runs_that_begin_at_once_have_different_numbers(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        folders = list(pool.map(lambda _: recorded(tmp_path, rows=1), range(24)))

    assert sorted(header_of(folder)["number"] for folder in folders) == list(range(1, 25))


@pytest.mark.parametrize(
    ("sentence", "clock"),
    [
        ("times are the vehicle's microseconds, not corrected: rows of 1 ms lie 1.000 ms apart by them", "true"),
        ("times are the vehicle's microseconds, corrected by 85/84 (`clock` 84/85)", "84/85"),
        ("the log does not show whether they run at 84/85 of real time", "unknown"),
        ("times are in s", None),
    ],
)
def test_what_version_0_2_stated_in_sentences_of_an_import_is_read_as_facts(
    tmp_path: Path, sentence: str, clock: str | None
) -> None:
    assumed = ["rotors turn the other way than a Crazyflie's, by CA_ROTOR0_KM to CA_ROTOR3_KM"]
    origin = {"file": "log.ulg", "sha256": "0", "program": "PX4", "clock": sentence, "assumed": assumed}
    found = read_run(changed(recorded(tmp_path), lambda content: content.update(origin=origin))).header.origin

    assert found is not None
    assert (found.clock, found.times, found.props_out, found.assumed) == (clock, sentence, True, tuple(assumed))


# Instruments that sample by themselves


def encoder(folder: Path, *, rate_hz: float = 100, **facts: Any) -> Path:
    columns = {"t": STARTED_S + np.arange(40) / rate_hz, "phi": np.arange(40)}
    facts_of = {"encoder": {"counts_per_turn": 8192.0, **facts}}
    return made_run(folder, "encoder", {"encoder": columns}, facts_of=facts_of).folder


def test_spans_in_which_an_encoder_gave_nothing_are_reported(tmp_path: Path) -> None:
    reasons = ("no position came", "unplugged", "no position came")
    gaps = [{"from_s": STARTED_S + i, "to_s": STARTED_S + i + 0.5, "reason": why} for i, why in enumerate(reasons)]
    (note,) = angle_record(encoder(tmp_path, gaps=gaps)).notes

    assert "1.5 s in 3 gaps: no position came, unplugged" in note
    with pytest.raises(DataError, match=r"devices.encoder.gaps.0.to_s"):
        angle_record(encoder(tmp_path, gaps=[{"from_s": 1.0}]))


@pytest.mark.parametrize("rate_hz", [0.5, 100_000])
def test_a_run_of_any_rate_is_in_seconds(tmp_path: Path, rate_hz: float) -> None:
    angle = angle_record(encoder(tmp_path, rate_hz=rate_hz))

    assert angle.time_s[-1] == pytest.approx(39 / rate_hz, abs=1e-6)
    assert angle.notes == ()


# Progress, which exists while a run is recorded


COUNTED = RunProgress(
    left_s=1.5,
    devices={"encoder": Counts(rows=7, lost=2, rate_hz=999.5), "scales": Counts(rows=1, lost=None, rate_hz=0.0)},
)


def test_the_counts_are_read_back_until_the_run_is_closed(tmp_path: Path) -> None:
    writer = new(tmp_path)
    assert read_progress(writer.folder) == RunProgress()
    writer.sync(COUNTED)
    assert read_progress(writer.folder) == COUNTED
    for content in (b"", b'{"devices": {"encoder": {"rows": -1, "lost": 0, "rate_hz": 1}}}', b"\xff"):
        (writer.folder / PROGRESS_FILE).write_bytes(content)
        assert read_progress(writer.folder) == RunProgress()
    with ThreadPoolExecutor(4) as threads:  # which write while the run is closed
        for _ in range(40):
            threads.submit(writer.sync, COUNTED)
        writer.close("complete")
    assert sorted(path.name for path in writer.folder.iterdir()) == ["encoder.csv", "run.toml"]


# Other programs change the folder meanwhile


@pytest.mark.parametrize("fate", ["removed", "moved", "replaced"])
def test_a_run_that_is_removed_or_moved_ends_with_the_next_rows_and_is_where_it_went(tmp_path: Path, fate: str) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0], [7]))
    moved = writer.folder.rename(tmp_path / "moved")
    if fate == "removed":
        shutil.rmtree(moved)
    if fate == "replaced":
        writer.folder.mkdir()
        writer.sync(COUNTED)

    with pytest.raises(DataError, match=r"encoder\.csv.* 1 row"):
        writer.append("encoder", ([2.0], [8]))
    with pytest.raises(DataError, match=r"run\.toml"):
        writer.close("failed")
    if fate != "removed":
        assert (moved / "encoder.csv").read_text() == "t,phi\n1.000000,7\n"
        assert read_run(moved).header.state == "recording"
    assert fate != "replaced" or not list(writer.folder.iterdir())


def test_a_file_that_another_program_cuts_ends_the_recording(tmp_path: Path) -> None:
    writer = new(tmp_path)
    writer.append("encoder", ([1.0, 2.0], [7, 8]))
    os.truncate(writer.folder / "encoder.csv", 8)

    with pytest.raises(DataError, match=r"was cut .* 2 rows"):
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


def test_a_file_is_written_beside_a_planted_link_and_not_through_it_nor_over_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("mine")
    path, pipe = tmp_path / "parameters.toml", tmp_path / "pipe"
    for name in (f".parameters.toml.{os.getpid()}.tmp", ".parameters.toml.tmp"):
        (tmp_path / name).symlink_to(tmp_path / "victim")
    write_whole(path, b"new")
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="a pipe"):
        write_whole(pipe, b"content")

    assert (tmp_path / "victim").read_text() == "mine"
    assert (path.read_text(), path.is_symlink(), pipe.is_fifo()) == ("new", False, True)


def test_a_pipe_among_fits_or_sources_is_not_waited_for(tmp_path: Path) -> None:
    keep_fit(tmp_path / "fits", FIT)
    os.mkfifo(tmp_path / "fits" / "2026-11-21_083013_inertia.json")
    os.mkfifo(tmp_path / "pipe")
    whole, broken = list_fits(tmp_path / "fits")
    sources = (Source("pipe", "0" * 64), Source("/dev/zero", "0" * 64))

    assert not isinstance(whole, DataError)
    assert isinstance(broken, DataError)
    assert stale_in(tmp_path, (), thesis_rig())(replace(FIT.section, sources=sources)) == ()
