"""Angles in MATLAB files: each layout in which classrooms save them gives the same angle as a CSV file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from cfid.errors import DataError
from cfid.recordings.angle import AngleRecord
from cfid.records.tables.blocks import open_table
from cfid.records.tables.wrench import WrenchReading, read_wrench

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


def test_forces_of_a_mat_file_are_read(tmp_path: Path) -> None:
    names = ("Fx_n", "Fy_n", "Fz_n", "Tx_nm", "Ty_nm", "Tz_nm")
    savemat(tmp_path / "a.mat", {"t": TIME_S, **{name: at + ANGLE_RAD for at, name in enumerate(names)}})
    np.testing.assert_array_equal(read_wrench(tmp_path / "a.mat", WrenchReading()).torque_nm[:, 2], 5 + ANGLE_RAD)


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
