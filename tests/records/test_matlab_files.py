"""Angles in MATLAB files: each layout in which classrooms save them gives the same angle as a CSV file."""

import io
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from cfid.errors import ConfigError, DataError
from cfid.records.tables.angle import AngleRecord, Reading, read_angle
from cfid.records.tables.blocks import open_table
from cfid.records.tables.matlab import converted_series

TIME_S = np.arange(400) / 100
ANGLE_RAD = 0.5 * np.exp(-TIME_S / 3) * np.cos(7 * TIME_S)
Contents = dict[str, Any]


def signals(*values: Any, labels: tuple[str, ...] = ("theta",)) -> Any:
    entries = [{"values": each, "label": label} for each, label in zip(values, labels, strict=True)]
    return entries[0] if len(entries) == 1 else np.array(entries, dtype=object)


def same(record: AngleRecord) -> bool:
    pairs = ((record.angle_rad, ANGLE_RAD), (record.time_s, TIME_S))
    return all(len(a) == len(b) and np.allclose(a, b, rtol=0, atol=1e-14) for a, b in pairs)


WAYS: dict[str, tuple[Contents, Contents]] = {
    "columns": ({"t": TIME_S[:, None], "theta": ANGLE_RAD[:, None]}, {}),
    "rows": ({"time": TIME_S[None], "angle": ANGLE_RAD[None], "m": 0.1, "p": [1.0, 2.0, 3.0]}, {}),
    "matrix": ({"data": np.column_stack([TIME_S, ANGLE_RAD])}, {}),
    "a To File block": ({"ans": np.vstack([TIME_S, ANGLE_RAD])}, {}),
    "struct": ({"run": {"time": TIME_S, "theta": ANGLE_RAD}}, {}),
    "structure with time": ({"theta": {"time": TIME_S, "signals": signals(ANGLE_RAD, labels=("",))}}, {}),
    "two signals": ({"o": {"time": TIME_S, "signals": signals(ANGLE_RAD, TIME_S, labels=("theta", "u"))}}, {}),
    "other names": ({"Time": TIME_S, "Data": ANGLE_RAD, "u": np.zeros(400)}, {"columns": ("Time", "Data")}),
    "two experiments": (
        {"a": {"t": TIME_S, "theta": ANGLE_RAD}, "b": {"t": TIME_S[:50], "phi": ANGLE_RAD[:50]}},
        {"columns": ("t", "theta")},
    ),
    "complex without imaginary parts": ({"t": TIME_S, "theta": ANGLE_RAD + 0j}, {}),
    "structure without time beside tout": (
        {"tout": TIME_S, "out": {"time": np.zeros((0, 0)), "signals": signals(ANGLE_RAD)}, "p": np.zeros(20)},
        {},
    ),
    "structure without time whose columns are named": (
        {"tout": TIME_S, "out": {"time": np.zeros((0, 0)), "signals": signals(ANGLE_RAD)}},
        {"columns": ("tout", "theta")},
    ),
    "no time": ({"theta": ANGLE_RAD}, {"rate_hz": 100.0}),
}


@pytest.mark.parametrize("way", WAYS)
def test_an_angle_is_the_same_however_a_mat_file_has_it(tmp_path: Path, way: str) -> None:
    contents, reading = WAYS[way]
    savemat(tmp_path / "swing.data", contents)  # recognised by its content
    assert same(read_angle(tmp_path / "swing.data", Reading(angle_unit="rad", **reading)))


def test_options_state_the_units_of_a_mat_file_as_of_a_csv_file(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": 1e3 * TIME_S, "theta_deg": np.degrees(ANGLE_RAD)})
    assert "`time_unit`" in read_angle(tmp_path / "a.mat", Reading()).notes[0]
    record = read_angle(tmp_path / "a.mat", Reading(time_unit="ms"))
    np.testing.assert_allclose(record.angle_rad, ANGLE_RAD, rtol=1e-14)


@pytest.mark.parametrize(("time", "angle"), [("Time__ms_", "pos__deg_"), ("time_ms_", "theta_deg_")])
def test_units_in_brackets_that_matlab_made_underscores_of_are_read(tmp_path: Path, time: str, angle: str) -> None:
    savemat(tmp_path / "a.mat", {time: 1e3 * TIME_S, angle: np.degrees(ANGLE_RAD)})
    record = read_angle(tmp_path / "a.mat", Reading())
    np.testing.assert_allclose(record.angle_rad, ANGLE_RAD, rtol=1e-14)
    assert record.time_s[-1] == pytest.approx(TIME_S[-1])


def test_an_angle_with_imaginary_parts_is_refused_by_its_name_and_a_column_beside_it_is_not(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD, "w": np.fft.fft(ANGLE_RAD)})
    assert same(read_angle(tmp_path / "a.mat", Reading(angle_unit="rad")))
    savemat(tmp_path / "b.mat", {"t": TIME_S, "theta": ANGLE_RAD + 0.1j})
    with pytest.raises(DataError, match=r"0\.1j\)' in column 'theta' is not a number"):
        read_angle(tmp_path / "b.mat", Reading(angle_unit="rad"))


@pytest.mark.parametrize(("name", "unit", "per_s"), [("theta", "seconds", 1.0), ("", "milliseconds", 1e3)])
def test_a_timeseries_that_was_saved_as_a_struct_has_its_own_name_and_units(
    tmp_path: Path, name: str, unit: str, per_s: float
) -> None:
    series = {"Time": per_s * TIME_S, "Data": np.degrees(ANGLE_RAD), "Name": name}
    info = {"TimeInfo": {"Units": unit}, "DataInfo": {"Units": "deg"}}
    savemat(tmp_path / "a.mat", {"theta": series | info})
    assert open_table(tmp_path / "a.mat").names == (f"Time [{unit}]", "theta [deg]")
    assert same(read_angle(tmp_path / "a.mat", Reading()))


def test_one_of_two_tables_of_equal_columns_is_chosen_by_the_struct(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {name: {"t": TIME_S, "theta": by * ANGLE_RAD} for name, by in (("a", 1), ("b", 0.5))})
    with pytest.raises(ConfigError, match=r"a\.t, a\.theta \(400 rows\); b\.t, b\.theta"):
        read_angle(tmp_path / "a.mat", Reading())
    record = read_angle(tmp_path / "a.mat", Reading(columns=("b.t", "b.theta"), angle_unit="rad"))
    np.testing.assert_allclose(record.angle_rad, 0.5 * ANGLE_RAD, rtol=1e-14)


def dspace(times: list[Contents], signals: list[Contents]) -> Contents:
    """Return a recording as ControlDesk saves it, in arrays of structs instead of cells."""
    arrays = {}
    for key, entries in (("X", times), ("Y", signals)):
        arrays[key] = np.array(
            [tuple(one.values()) for one in entries], dtype=[(field, object) for field in entries[0]]
        )
    return {"pend_001": {**arrays, "Description": {"General": "a swing"}, "RTProgram": {"BoardName": "DS1104"}}}


ENCODER = '"Model Root"/Encoder/theta'
CLOCK = {"Name": "Time", "Type": 4, "Data": TIME_S, "Unit": "s"}


@pytest.mark.parametrize("name", [ENCODER, f"{ENCODER}/Out1", "Platform()://Model Root/theta/Value"])
def test_an_angle_of_dspace_is_read_with_the_time_that_stands_beside_it(tmp_path: Path, name: str) -> None:
    measured = [{"Name": name, "Data": ANGLE_RAD, "Unit": "rad"}, {"Name": "Model/u", "Data": TIME_S, "Unit": "V"}]
    savemat(tmp_path / "a.mat", dspace([CLOCK], measured))
    assert same(read_angle(tmp_path / "a.mat", Reading()))


def test_a_signal_of_dspace_has_the_time_of_its_own_raster(tmp_path: Path) -> None:
    slow = {**CLOCK, "Data": TIME_S[::2]}
    other = {"Name": "Model/u", "Data": TIME_S[::2], "XIndex": 1}
    savemat(tmp_path / "a.mat", dspace([slow, CLOCK], [other, {"Name": ENCODER, "Data": ANGLE_RAD, "XIndex": 2}]))
    record = read_angle(tmp_path / "a.mat", Reading(columns=("Time [s]", "theta"), angle_unit="rad"))
    assert same(record)


def test_signals_of_dspace_whose_last_names_are_the_same_have_their_paths(tmp_path: Path) -> None:
    measured = [{"Name": f"Model/{block}/theta", "Data": by * ANGLE_RAD} for block, by in (("a", 2), ("b", 1))]
    savemat(tmp_path / "a.mat", dspace([CLOCK], measured))
    record = read_angle(tmp_path / "a.mat", Reading(columns=("Time [s]", "Model/b/theta"), angle_unit="rad"))
    assert same(record)


def test_a_time_of_another_length_than_a_structure_without_one_is_refused_with_both(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"tout": TIME_S[1:], "o": {"time": np.zeros((0, 0)), "signals": signals(ANGLE_RAD)}})
    with pytest.raises(DataError, match=r"tout has 399 rows, and no other array has as many \(theta 400\)"):
        read_angle(tmp_path / "a.mat", Reading())


def test_a_time_of_another_length_than_the_angle_is_refused_with_both_lengths(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD[:-1]})
    with pytest.raises(DataError, match=r"t has 400 rows, and no other array has as many \(theta 399\)"):
        read_angle(tmp_path / "a.mat", Reading())


def test_a_matrix_of_more_columns_is_a_question_about_them_and_not_about_decimal_points(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"data": np.column_stack([TIME_S, ANGLE_RAD, 2 * ANGLE_RAD])})
    with pytest.raises(DataError, match=r"no header for its 3 columns: give `columns` TIME,ANGLE by .*, as in 1,2\.$"):
        read_angle(tmp_path / "a.mat", Reading(angle_unit="rad"))


def test_two_tables_are_a_question_that_names_the_option(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"a": {"t": TIME_S, "x": ANGLE_RAD}, "b": {"t": TIME_S, "theta": ANGLE_RAD}})
    with pytest.raises(
        ConfigError, match=r"several tables: a.t, a.x \(400 rows\); b.t, b.theta \(400 rows\).*`columns`"
    ):
        read_angle(tmp_path / "a.mat", Reading(angle_unit="rad"))


@pytest.mark.parametrize("length", [130, 400, 3000])
def test_a_cut_mat_file_ends_in_a_sentence(tmp_path: Path, length: int) -> None:
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD})
    (tmp_path / "a.mat").write_bytes((tmp_path / "a.mat").read_bytes()[:length])
    with pytest.raises(DataError, match=r"a\.mat: (?:not readable as a MATLAB file|no arrays of numbers)"):
        read_angle(tmp_path / "a.mat", Reading(angle_unit="rad"))


@pytest.mark.parametrize("at", [-3, 125])
def test_a_damaged_mat_file_ends_in_a_sentence_whichever_command_looks_first(tmp_path: Path, at: int) -> None:
    """Previously, a wrong checksum of a compressed part or another version gave a traceback while looking for a log."""
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD}, do_compression=True)
    content = bytearray((tmp_path / "a.mat").read_bytes())
    content[at] ^= 0x55
    (tmp_path / "a.mat").write_bytes(content)
    for read in (converted_series, lambda path: read_angle(path, Reading(angle_unit="rad"))):
        with pytest.raises(DataError, match=r"a\.mat: not readable as a MATLAB file: it is damaged \(.+\)"):
            read(tmp_path / "a.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_an_element_of_an_unknown_type_ends_in_a_sentence(tmp_path: Path, compressed: bool) -> None:
    plain = io.BytesIO()
    savemat(plain, {"t": TIME_S, "theta": ANGLE_RAD})
    content = bytearray(plain.getvalue())
    at = content.index(struct.pack("<II", 9, 8 * len(TIME_S)))  # the tag of an array of doubles
    content[at : at + 4] = struct.pack("<I", 15360)  # this type makes SciPy's reader end the process
    if compressed:
        packed = zlib.compress(bytes(content[128:]))
        content[128:] = struct.pack("<II", 15, len(packed)) + packed
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(DataError, match="not readable as a MATLAB file: an element has the unknown type 15360"):
        read_angle(tmp_path / "a.mat", Reading(angle_unit="rad"))


def test_a_mat_file_without_arrays_is_refused_with_a_way_out(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"note": "hello", "m": 1.0})
    with pytest.raises(DataError, match=r"no arrays of numbers.*save their time and values as arrays"):
        read_angle(tmp_path / "a.mat", Reading())


def test_version_7_3_without_its_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)  # as if it were not installed
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(ConfigError, match=r'pip install "cfid\[mat\]"'):
        read_angle(tmp_path / "a.mat", Reading())


def _structure(file: Any) -> None:
    group = file.create_group("theta")
    group["time"] = TIME_S[None]
    group.create_group("signals")["values"] = ANGLE_RAD[None]


def _two_signals(file: Any) -> None:
    import h5py

    group = file.create_group("out")
    group["time"] = TIME_S[None]
    references = file.create_group("#refs#")
    references["a"], references["b"] = ANGLE_RAD[None], TIME_S[None]
    for name, text in (("la", "theta"), ("lb", "u")):
        references[name] = np.array([list(map(ord, text))], dtype=np.uint16).T
        references[name].attrs["MATLAB_class"] = np.bytes_("char")
    inside = group.create_group("signals")
    for field, places in (("values", "ab"), ("label", ("la", "lb"))):
        inside.create_dataset(field, (2, 1), h5py.ref_dtype)[:, 0] = [references[place].ref for place in places]


def _dspace(file: Any) -> None:
    import h5py

    file["run/X/Data"], references = TIME_S[None], file.create_group("#refs#")
    texts = [np.array([list(map(ord, text))], np.uint16).T for text in ("Model/theta", "Model/u")]
    for field, values, kind in (("Data", (ANGLE_RAD[None], TIME_S[None]), "double"), ("Name", texts, "char")):
        for at, value in enumerate(values):
            references[f"{field}{at}"] = value
            references[f"{field}{at}"].attrs["MATLAB_class"] = np.bytes_(kind)
        inside = file.require_group("run/Y").create_dataset(field, (2, 1), h5py.ref_dtype)
        inside[:, 0] = [references[f"{field}{at}"].ref for at in range(2)]


def _matrix(file: Any) -> None:
    file["data"] = np.vstack([TIME_S, ANGLE_RAD])


def _complex(file: Any) -> None:
    pairs = np.zeros((1, len(ANGLE_RAD)), [("real", "<f8"), ("imag", "<f8")])
    pairs["real"] = ANGLE_RAD
    file["t"], file["theta"] = TIME_S[None], pairs


@pytest.mark.parametrize("fill", [_structure, _two_signals, _dspace, _matrix, _complex])
def test_version_7_3_is_read_as_version_5(tmp_path: Path, fill: Callable[[Any], None]) -> None:
    h5py = pytest.importorskip("h5py", reason='h5py comes with pip install "cfid[mat]"')
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        fill(file)
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\x02IM")
    assert same(read_angle(tmp_path / "a.mat", Reading(angle_unit="rad")))


def _elsewhere(file: Any) -> None:
    Path(file.filename).with_suffix(".bin").write_bytes(TIME_S.tobytes())
    place = (str(Path(file.filename).with_suffix(".bin")), 0, TIME_S.nbytes)
    file.create_dataset("t", TIME_S.shape, TIME_S.dtype, external=[place])


def _linked(file: Any) -> None:
    import h5py

    file["t"] = h5py.ExternalLink("other.mat", "/t")


def _virtual(file: Any) -> None:
    import h5py

    layout = h5py.VirtualLayout(TIME_S.shape, TIME_S.dtype)
    layout[:] = h5py.VirtualSource("other.mat", "t", TIME_S.shape)
    file.create_virtual_dataset("t", layout)


def _never_written(file: Any) -> None:
    file.create_dataset("t", (10**9,), np.float64, chunks=(1000,))


def _one_array_many_times(file: Any) -> None:
    import h5py

    file["#refs#/a"] = np.zeros(10**6)
    file.create_dataset("t", (300,), h5py.ref_dtype)[:] = [file["#refs#/a"].ref] * 300


@pytest.mark.parametrize(
    ("fill", "said"),
    [
        (_elsewhere, "in other files"),
        (_linked, "in other files"),
        (_virtual, "in other files"),
        (_never_written, "state to be 8000 MB"),
        (_one_array_many_times, "state to be"),
    ],
)
def test_version_7_3_has_its_own_numbers_and_no_more_than_its_size_allows(
    tmp_path: Path, fill: Callable[[Any], None], said: str
) -> None:
    h5py = pytest.importorskip("h5py", reason='h5py comes with pip install "cfid[mat]"')
    with h5py.File(tmp_path / "a.mat", "w") as file:
        fill(file)
    with pytest.raises(DataError, match=said):
        open_table(tmp_path / "a.mat")


def test_zeros_packed_a_thousandfold_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": np.zeros(20_000_000)}, do_compression=True)
    with pytest.raises(DataError, match="state to be 160 MB or more: no recording is packed so small"):
        open_table(tmp_path / "a.mat")


def test_a_long_file_is_read_in_blocks_and_every_number_comes_back(tmp_path: Path) -> None:
    time_s = np.arange(70_000) / 1000
    angle_rad = np.random.default_rng(1).normal(size=len(time_s))
    savemat(tmp_path / "a.mat", {"t": time_s, "theta": angle_rad})
    table = open_table(tmp_path / "a.mat")
    np.testing.assert_array_equal(table.numbers(["t", "theta"]), np.column_stack([time_s, angle_rad]))
    assert len(list(table.blocks())) == 3
    assert table.line_of_row(69_999) == 70_001


def test_variables_of_a_large_file_are_read_one_by_one(tmp_path: Path) -> None:
    bulk = {f"u{at}": np.zeros(5_000_000) for at in range(2)}  # 80 MB
    savemat(tmp_path / "a.mat", {"theta": {"time": TIME_S, "signals": signals(ANGLE_RAD, labels=("",))}, **bulk})
    assert same(read_angle(tmp_path / "a.mat", Reading(angle_unit="rad", columns=("time", "theta"))))


def test_a_file_of_version_4_is_refused_with_how_to_save_it(tmp_path: Path) -> None:
    path = tmp_path / "swing.mat"
    savemat(path, {"t": TIME_S, "theta_rad": ANGLE_RAD}, format="4")
    with pytest.raises(DataError, match="version 4: save it again, with -v7"):
        read_angle(path, Reading())
