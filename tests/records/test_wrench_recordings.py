"""Forces and torques of a run or of a bare file: in N and Nm, or refused with the line and the option to give."""

import tomllib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import tomli_w

from cfid.errors import ConfigError, DataError
from cfid.recordings.angle import angle_record
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import RunWriter, create_run
from cfid.records.tables.wrench import WrenchReading, WrenchRecord, holds_wrench, read_wrench

HEAD = "t,Fx,Fy,Fz,Tx,Ty,Tz"
ROWS = 200
EPOCH_S = 1_763_712_345.0
TIME_S = np.arange(ROWS) / 7000
COUNTS = np.random.default_rng(3).integers(-2_000_000, 2_000_000, (ROWS, 6))
USUAL = "fts.csv: counts are read as `counts_per_n` 1000000 `counts_per_nm` 1000000."
FACTS = {"counts_per_n": 5e5, "counts_per_nm": 4e6, "settings": {"product": "Net F/T"}}


def text_of(values: npt.NDArray[Any] = COUNTS, time: npt.NDArray[Any] = TIME_S, head: str = HEAD) -> str:
    rows = [
        "".join([f"{t:.6f}", *(f",{x}" for x in row)]) for t, row in zip(time.tolist(), values.tolist(), strict=True)
    ]
    return "\n".join([*([head] if head else []), *rows, ""])


def read(folder: Path, text: str, **options: Any) -> WrenchRecord:
    (folder / "fts.csv").write_text(text)
    return read_wrench(folder / "fts.csv", WrenchReading(**options))


def refusal(folder: Path, text: str, kind: type[Exception] = DataError, **options: Any) -> str:
    with pytest.raises(kind) as caught:
        read(folder, text, **options)
    return str(caught.value)


def new(folder: Path, facts: dict[str, Any] = FACTS, *, simulated: bool = False) -> RunWriter:
    columns = (*HEAD.split(","), "rdt_sequence", "ft_sequence", "status")
    record = DeviceRecord.model_validate({"file": "loadcell.csv", "columns": columns, **facts})
    return create_run(
        folder / "runs",
        kind="loadcell",
        label=Label(note="one motor"),
        devices={"loadcell": record},
        started=datetime(2026, 11, 21, 8, 30, 12, tzinfo=UTC),
        cfid_version="0.1.0",
        simulated=simulated,
    )


def fill(writer: RunWriter, status: npt.ArrayLike = 0) -> Path:
    words = np.broadcast_to(np.asarray(status, dtype=np.uint32), ROWS)
    writer.append("loadcell", (EPOCH_S + TIME_S, *COUNTS.T, np.arange(ROWS) + 1, 900 + np.arange(ROWS), words))
    return writer.folder


def recorded(folder: Path, facts: dict[str, Any] = FACTS, *, status: npt.ArrayLike = 0, **how: Any) -> Path:
    with new(folder, facts, **how) as writer:
        return fill(writer, status)


# Runs


def test_a_run_is_read_with_the_scales_of_its_box(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    record = read_wrench(folder, WrenchReading())
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 5e5)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 4e6)
    assert record.time_s == pytest.approx(TIME_S, abs=1e-6)
    assert record.status is not None
    assert str(record.status.dtype) == "uint32"
    assert not record.status.any()
    assert (record.name, record.run, record.label.note) == (folder.name, folder.name, "one motor")
    assert (record.lost, record.notes) == (0, ())


def test_a_scale_that_is_given_holds_for_a_run_and_other_options_do_not(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    reading = WrenchReading(counts_per_n=1e6, units="n,nm", time_unit="us", skip_lines=9, rate_hz=5.0)
    record = read_wrench(folder, reading)
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e6)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 4e6)
    assert record.time_s == pytest.approx(TIME_S, abs=1e-6)


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        ({"counts_per_nm": 1e6}, "devices.loadcell.counts_per_n is missing: give `counts_per_n`."),
        ({"counts_per_n": 1e6}, "devices.loadcell.counts_per_nm is missing: give `counts_per_nm`."),
        (FACTS | {"counts_per_n": 0}, "devices.loadcell.counts_per_n: should be greater than 0, not 0"),
        (FACTS | {"gaps": [{"from_s": 1.0}]}, "devices.loadcell.gaps.0.to_s is missing"),
    ],
)
def test_a_run_that_does_not_say_its_scale_or_says_nonsense_is_refused_by_key(
    tmp_path: Path, facts: dict[str, Any], expected: str
) -> None:
    folder = recorded(tmp_path, facts)
    with pytest.raises(DataError) as caught:
        read_wrench(folder, WrenchReading())
    assert str(caught.value).startswith(f"{folder / 'run.toml'}: {expected}")


def test_a_scale_missing_in_a_run_can_be_given(tmp_path: Path) -> None:
    folder = recorded(tmp_path, {"counts_per_nm": 4e6})
    assert read_wrench(folder, WrenchReading(counts_per_n=5e5)).force_n == pytest.approx(COUNTS[:, :3] / 5e5)


def test_what_a_run_lacks_is_said(tmp_path: Path) -> None:
    gaps = [{"from_s": EPOCH_S, "to_s": EPOCH_S + 1.5, "reason": "the stream broke off"}] * 2
    writer = new(tmp_path, FACTS | {"gaps": gaps}, simulated=True)
    fill(writer)
    writer.count_lost("loadcell", 40)
    writer.close("failed", reason="no power")
    record = read_wrench(writer.folder, WrenchReading())
    assert record.lost == 40
    assert [note.removeprefix(f"{writer.folder.name}: ") for note in record.notes] == [
        "the run failed (no power); the recorded rows are used.",
        "40 samples were lost while recording.",
        "recorded on the simulated rig.",
        "no samples for 3.0 s in 2 gaps: the stream broke off.",
    ]


def test_an_angle_of_the_simulated_rig_says_so_too(tmp_path: Path) -> None:
    encoder = DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn=8192.0)
    started = datetime(2026, 11, 21, tzinfo=UTC)
    with create_run(
        tmp_path,
        kind="a",
        label=Label(),
        devices={"encoder": encoder},
        started=started,
        cfid_version="",
        simulated=True,
    ) as writer:
        writer.append("encoder", (EPOCH_S + TIME_S, np.arange(ROWS)))
    assert angle_record(writer.folder).notes == (f"{writer.folder.name}: recorded on the simulated rig.",)


def test_a_run_cut_at_any_byte_gives_its_first_rows_and_says_so(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    file, whole = folder / "loadcell.csv", read_wrench(folder, WrenchReading())
    content = file.read_bytes()
    for length in range(len(content) - 150, len(content)):
        file.write_bytes(content[:length])
        record = read_wrench(folder, WrenchReading())
        rows = content.count(b"\n", 0, length) - 1
        assert record.force_n.tolist() == whole.force_n[:rows].tolist()
        assert any(f"200 rows were recorded, but loadcell.csv has {rows}" in note for note in record.notes)
        assert any("the last line was cut" in note for note in record.notes) == (content[length - 1] != ord("\n"))


def test_a_run_still_recording_is_read_as_cut(tmp_path: Path) -> None:
    writer = new(tmp_path)
    fill(writer)
    assert "the run was cut, or is still being recorded" in read_wrench(writer.folder, WrenchReading()).notes[0]
    writer.close("complete")


@pytest.mark.parametrize(("product", "expected"), [("Net F/T", "broken"), ("Axia80", "broken gage")])
def test_a_status_that_is_not_zero_is_counted_and_told_by_the_box_family(
    tmp_path: Path, product: str, expected: str
) -> None:
    status = np.where(np.isin(np.arange(ROWS), (70, 71)), 1 << 31 | 1 << 2, 0)
    folder = recorded(tmp_path, FACTS | {"settings": {"product": product}}, status=status)
    record = read_wrench(folder, WrenchReading())
    assert record.status is not None
    assert record.status.tolist() == status.tolist()
    (note,) = record.notes
    assert "2 of 200 samples have a status that is not 0 (first: line 72): " in note
    assert (expected in note) == (product == "Axia80")


def test_a_run_without_a_load_cell_or_without_an_axis_is_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    file = folder / "loadcell.csv"
    file.write_text(file.read_text().replace("Ty,Tz", "a,b", 1))
    with pytest.raises(DataError, match="no column Ty, Tz among t, Fx, Fy, Fz, Tx, a, b"):
        read_wrench(folder, WrenchReading())
    toml = tomllib.loads((folder / "run.toml").read_text())
    toml["devices"]["scales"] = toml["devices"].pop("loadcell")
    (folder / "run.toml").write_bytes(tomli_w.dumps(toml).encode())
    with pytest.raises(DataError, match="holds no loadcell recording; its devices: scales"):
        read_wrench(folder, WrenchReading())


# Bare files


def test_a_file_of_the_thesis_is_read_with_the_usual_scale_and_that_is_said(tmp_path: Path) -> None:
    record = read(tmp_path, text_of(time=np.round(EPOCH_S + TIME_S, 3)))
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e6)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e6)
    assert (record.status, record.lost, record.run, record.name) == (None, None, None, "fts")
    assert record.notes[1:] == (USUAL,)
    assert "samples repeat the time of the previous one" in record.notes[0]


def test_only_the_scale_that_is_not_given_is_said(tmp_path: Path) -> None:
    assert read(tmp_path, text_of(), counts_per_n=1e6, counts_per_nm=1e6).notes == ()
    record = read(tmp_path, text_of(), counts_per_nm=1e3)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e3)
    assert record.notes == ("fts.csv: counts are read as `counts_per_n` 1000000.",)


@pytest.mark.parametrize(
    "head", ["t_s,Fx (N),Fy (N),Fz (N),Tx (Nm),Ty (Nm),Tz (Nm)", "t,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm"]
)
def test_newtons_are_read_from_the_head_or_by_option(tmp_path: Path, head: str) -> None:
    values = COUNTS / 1e6
    for record in (read(tmp_path, text_of(values, head=head)), read(tmp_path, text_of(values), units="n,nm")):
        assert record.force_n == pytest.approx(values[:, :3])
        assert record.torque_nm == pytest.approx(values[:, 3:])
        assert record.notes == ()


@pytest.mark.parametrize("value", ["0.5", "2147483649", "-1e300"])
def test_what_can_be_no_count_is_refused_with_its_line_and_the_option_to_say(tmp_path: Path, value: str) -> None:
    lines = text_of().split("\n")
    fields = lines[120].split(",")
    lines[120] = ",".join([*fields[:3], value, *fields[4:]])
    message = refusal(tmp_path, "\n".join(lines))
    assert f"fts.csv:121: {float(value):.9g} in column 'Fz' is not a count" in message
    assert "give `units` n,nm" in message


def test_counts_taken_for_newtons_are_refused(tmp_path: Path) -> None:
    assert "are they counts? Then leave out `units` n,nm" in refusal(tmp_path, text_of(), units="n,nm")


@pytest.mark.parametrize("unit", ["kN", "dyn", "lbs"])
def test_forces_in_a_unit_that_is_not_read_are_refused_at_once(tmp_path: Path, unit: str) -> None:
    head = ",".join(["t", *(f"{axis} ({unit})" for axis in HEAD.split(",")[1:])])
    message = refusal(tmp_path, text_of(COUNTS / 1e6, head=head))
    assert f"column 'Fx ({unit})' is in {unit}: forces are read in N, mN, cN, gf, kgf, lbf or ozf, torques" in message
    assert message.endswith("or both in counts. Convert it.")
    beside = text_of(COUNTS[:, [0, 1, 2, 3, 4, 5, 0]], head=f"{HEAD},Fx ({unit})")
    assert read(tmp_path, beside).force_n[:, 0] == pytest.approx(COUNTS[:, 0] / 1e6)


@pytest.mark.parametrize(
    ("force", "torque", "newtons", "newton_metres"),
    [
        ("[mN]", "[mN m]", 1e-3, 1e-3),
        (" (N)", " (Nmm)", 1.0, 1e-3),
        ("_lbf", " (lbf-in)", 4.4482216152605, 0.11298482902762),
        (" (kgf)", " (kgf·cm)", 9.80665, 0.0980665),
        (" [gf]", " [gf*mm]", 9.80665e-3, 9.80665e-6),
        (" (lbf)", " (lbf·ft)", 4.4482216152605, 1.3558179483314),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_forces_are_read_in_the_units_of_stands_with_a_note(
    tmp_path: Path, force: str, torque: str, newtons: float, newton_metres: float, named: bool
) -> None:
    head = ",".join(["t", *(f"{axis}{force if axis[0] == 'F' else torque}" for axis in HEAD.split(",")[1:])])
    record = read(tmp_path, text_of(COUNTS / 1e3, head=head), columns=tuple(head.split(",")) if named else ())
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e3 * newtons, rel=1e-12)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e3 * newton_metres, rel=1e-12)
    (note,) = record.notes
    assert f"Tx, Ty, Tz in {torque.strip(' ([])_')}: converted to N and N m." in note
    assert (f"Fx, Fy, Fz in {force.strip(' ([])_')} and " in note) == (newtons != 1)


def test_loads_of_large_cells_are_possible_in_small_units_and_counts_in_them_are_not(tmp_path: Path) -> None:
    head = "t,Fx [mN],Fy [mN],Fz [mN],Tx [mNm],Ty [mNm],Tz [mNm]"
    assert read(tmp_path, text_of(COUNTS * 20.0, head=head)).force_n == pytest.approx(COUNTS[:, :3] / 50)
    assert "more than any load cell measures" in refusal(tmp_path, text_of(COUNTS * 900.0, head=head))


@pytest.mark.parametrize("unit", ["n", "counts"])
def test_a_single_value_that_no_load_cell_measures_is_left_out_and_named(tmp_path: Path, unit: str) -> None:
    head = ",".join(
        ["t", *(f"{axis}_{'nm' if unit == 'n' and axis[0] == 'T' else unit}" for axis in HEAD.split(",")[1:])]
    )
    values = COUNTS if unit == "counts" else COUNTS / 1e6
    rows = text_of(values, head=head).split("\n")
    fields = rows[120].split(",")
    rows[120] = ",".join([*fields[:3], "1e300", *fields[4:]])
    record = read(tmp_path, "\n".join(rows))
    assert len(record.time_s) == ROWS - 1
    assert record.force_n[119] == pytest.approx(COUNTS[120, :3] / 1e6)
    assert "fts.csv: 1 row of 200 with a value that no load cell measures (first: 1e+300 in line 121) left out." in (
        record.notes
    )


def test_a_header_of_newtons_over_counts_is_asked_about_with_what_can_be_done(tmp_path: Path) -> None:
    head = ",".join(["t", *(f"{axis}_{'n' if axis[0] == 'F' else 'nm'}" for axis in HEAD.split(",")[1:])])
    message = refusal(tmp_path, text_of(head=head))
    assert "are they counts? Then write so in the header, as in Fx_counts." in message
    assert "`units`" not in message


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"counts_per_n": 0.0}, "`counts_per_n` 0: has to be above zero"),
        ({"counts_per_nm": float("nan")}, "`counts_per_nm` nan: has to be above zero"),
        ({"columns": ("t", "Fz")}, "names 7 columns"),
        ({"columns": ("t", "Fx", "Fx", "Fz", "Tx", "Ty", "Tz")}, "none of them twice"),
        ({"rate_hz": 0.0}, "`rate_hz` 0: has to be above zero"),
    ],
)
def test_options_that_make_no_sense_are_a_usage_error(tmp_path: Path, options: dict[str, Any], expected: str) -> None:
    assert expected in refusal(tmp_path, text_of(), ConfigError, **options)


def test_a_scale_for_newtons_and_a_unit_against_the_head_are_a_usage_error(tmp_path: Path) -> None:
    text = text_of(COUNTS / 1e6, head="t,Fx_n,Fy_n,Fz_n,Tx_nm,Ty_nm,Tz_nm")
    assert "the file is in N and Nm, not in counts" in refusal(tmp_path, text, ConfigError, counts_per_n=1e6)
    assert "column 'Fx_n' is in n, but `units` is counts" in refusal(tmp_path, text, ConfigError, units="counts")


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        ("t,Fx,Fy,F3,Tx,Ty,T3", "no column Fz, Tz among t, Fx, Fy, F3, Tx, Ty, T3: give `columns` TIME,FX"),
        ("when,Fx,Fy,Fz,Tx,Ty,Tz", "no column of time (t, time) among when, Fx"),
        ("t,Fx,Fy,Fz,Tx,Ty,Fz_counts", "more than one column Fz: Fz (4), Fz_counts (7)"),
        ("t,Fx,Fy,Fz,Tx_counts,Ty,Tz_nm", "some axes in counts and some not: give `units`"),
    ],
)
def test_a_head_that_leaves_a_choice_is_asked_about(tmp_path: Path, head: str, expected: str) -> None:
    assert expected in refusal(tmp_path, text_of(head=head))


def test_columns_without_a_head_are_taken_in_their_order_and_others_by_number(tmp_path: Path) -> None:
    assert read(tmp_path, text_of(head="")).force_n == pytest.approx(COUNTS[:, :3] / 1e6)
    swapped = read(tmp_path, text_of(head=""), columns=("1", "4", "3", "2", "5", "6", "7"))
    assert swapped.force_n == pytest.approx(COUNTS[:, 2::-1] / 1e6)
    six = "\n".join(line.partition(",")[2] for line in text_of().split("\n"))
    assert read(tmp_path, six, rate_hz=7000.0).time_s == pytest.approx(TIME_S, abs=1e-12)
    assert "6 columns and no time: give `rate_hz`" in refusal(tmp_path, six.partition("\n")[2])


SPOILS: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "time going back": (lambda rows: [*rows[:100], *rows[50:]], "fts.csv:102: time goes back"),
    "a sixth without a number": (
        lambda rows: [*rows[:50], *10 * ["0.008,1,1,nan,1,1,1"]],
        "fts.csv:52: 'nan' in column 'Fz'",
    ),
    "a row too short": (lambda rows: [*rows[:50], "0.008,1,1"], "fts.csv:52: 3 fields where the file has 7"),
    "a handful of rows": (lambda rows: rows[:9], "9 rows; a recording has at least 16"),
    "milliseconds or microseconds": (
        lambda rows: [f"{i * 50}{row[row.index(',') :]}" for i, row in enumerate(rows)],
        "`time_unit` ms or us",
    ),
}


@pytest.mark.parametrize("spoil", SPOILS)
def test_a_spoilt_file_is_refused_with_its_line(tmp_path: Path, spoil: str) -> None:
    change, expected = SPOILS[spoil]
    head, *rows = text_of().splitlines()
    assert expected in refusal(tmp_path, "\n".join([head, *change(rows), ""]))


def test_a_status_word_beside_bare_counts_is_read_and_one_that_is_none_refused(tmp_path: Path) -> None:
    values = np.hstack([COUNTS, np.full((ROWS, 1), 2**32 - 1)])
    record = read(tmp_path, text_of(values, head=f"{HEAD},status"))
    assert record.status is not None
    assert record.status[0] == 2**32 - 1
    message = refusal(tmp_path, text_of(np.hstack([COUNTS, np.full((ROWS, 1), -1)]), head=f"{HEAD},status"))
    assert "fts.csv:2: status -1 is not a word of 32 bits" in message


def test_the_kind_of_a_bare_file_is_told_by_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"

    def holds(text: str, **options: Any) -> bool:
        path.write_text(text)
        return holds_wrench(path, WrenchReading(**options))

    assert holds(text_of())
    assert holds(text_of(head=""))
    assert holds("t,fz_n\n0,1\n")
    assert holds("a,b\n0,1\n", columns=("1",) * 7)
    assert not holds("t,phi\n0,1\n")
    assert not holds("0,1\n1,1\n")


@pytest.mark.parametrize("options", [{}, {"units": "n,nm"}])
def test_forces_in_a_unit_that_is_not_read_are_refused_also_where_columns_are_named(
    tmp_path: Path, options: dict[str, Any]
) -> None:
    head = "t," + ",".join(f"{axis} (dyn)" if axis[0] == "F" else f"{axis} (lbf·in)" for axis in HEAD.split(",")[1:])
    message = refusal(
        tmp_path,
        text_of(COUNTS / 1e6, head=head),
        columns=tuple(head.split(",")),
        **options,
    )
    assert "column 'Fx (dyn)' is in dyn: forces are read in N, mN, cN, gf, kgf, lbf or ozf" in message
    assert message.endswith("Convert it.")


def test_an_option_that_contradicts_the_unit_of_a_header_is_refused_also_where_columns_are_named(
    tmp_path: Path,
) -> None:
    head = "t,Kraft x (lbf),Fy (lbf),Fz (lbf),Tx (lbf·in),Ty (lbf·in),Tz (lbf·in)"
    options: dict[str, Any] = {"columns": tuple(head.split(",")), "units": "n,nm"}
    message = refusal(tmp_path, text_of(COUNTS / 1e6, head=head), ConfigError, **options)
    assert "column 'Kraft x (lbf)' is in lbf, but `units` is n." in message


@pytest.mark.parametrize("unit", ["(N)", "[N]"])
def test_forces_in_newtons_are_read_by_their_header(tmp_path: Path, unit: str) -> None:
    head = "t," + ",".join(f"{axis} {unit}" if axis[0] == "F" else f"{axis} (N m)" for axis in HEAD.split(",")[1:])
    record = read(tmp_path, text_of(COUNTS / 1e6, head=head))
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e6)
