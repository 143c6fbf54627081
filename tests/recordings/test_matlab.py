"""MATLAB files: arrays of one length and Simulink's structure are columns; damage ends in a sentence."""

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
from cfid.recordings.matlab import is_matlab, read_matlab
from cfid.recordings.recording import How
from cfid.recordings.times import series_of

TIME_S = np.arange(400) / 100
ANGLE_RAD = 0.5 * np.exp(-TIME_S / 3) * np.cos(7 * TIME_S)
Contents = dict[str, Any]


def signals(*values: Any, labels: tuple[str, ...] = ("theta",)) -> Any:
    entries = [{"values": each, "label": label} for each, label in zip(values, labels, strict=True)]
    return entries[0] if len(entries) == 1 else np.array(entries, dtype=object)


def angle_in(path: Path, how: How) -> tuple[Any, Any]:
    """Return the times and the angle of a file, which has one."""
    series = series_of(read_matlab(path, how), how)
    name = next(name for name in ("phi", "theta", "angle", "data_2", "ans_2") if name in series.names)
    return series.time_s, series.column(name).values


WAYS: dict[str, tuple[Contents, Contents]] = {
    "rows": ({"time": TIME_S[None], "angle": ANGLE_RAD[None], "m": 0.1, "p": [1.0, 2.0, 3.0]}, {}),
    "a To File block": ({"ans": np.vstack([TIME_S, ANGLE_RAD])}, {"columns": ("t=ans_1", "phi=ans_2")}),
    "struct": ({"run": {"time": TIME_S, "theta": ANGLE_RAD}}, {"columns": ("t=run.time", "phi=run.theta")}),
    "structure with time": ({"theta": {"time": TIME_S, "signals": signals(ANGLE_RAD, labels=("",))}}, {}),
    "two signals": ({"o": {"time": TIME_S, "signals": signals(ANGLE_RAD, TIME_S, labels=("theta", "u"))}}, {}),
    "two lengths": (
        {"t": TIME_S, "theta": ANGLE_RAD, "slow": TIME_S[:50], "u": ANGLE_RAD[:50]},
        {"columns": ("t=t", "phi=theta")},
    ),
    "no time": ({"theta": ANGLE_RAD}, {"rate_hz": 100.0}),
}


@pytest.mark.parametrize("way", WAYS)
def test_an_angle_is_the_same_however_a_mat_file_has_it(tmp_path: Path, way: str) -> None:
    contents, how = WAYS[way]
    savemat(tmp_path / "swing.data", contents)  # recognised by its content
    assert is_matlab(tmp_path / "swing.data")
    time_s, angle_rad = angle_in(tmp_path / "swing.data", How(**how))
    np.testing.assert_array_equal(angle_rad, ANGLE_RAD)
    np.testing.assert_allclose(time_s, TIME_S, atol=1e-14)


def test_arrays_of_several_lengths_are_listed(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD[:-1]})
    with pytest.raises(DataError, match=r"t \(400\), theta \(399\).*`columns`") as refused:
        read_matlab(tmp_path / "a.mat")
    assert refused.value.code == "several-lengths"
    with pytest.raises(ConfigError, match="no array 'phi'"):
        read_matlab(tmp_path / "a.mat", How(columns=("t=t", "x=phi")))


def test_a_fault_names_the_row(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": np.concatenate([TIME_S[:30], TIME_S[:30]]), "theta": ANGLE_RAD[:60]})
    with pytest.raises(DataError, match=r"a\.mat:31: time goes back"):
        series_of(read_matlab(tmp_path / "a.mat"), How())


@pytest.mark.parametrize("length", [130, 3000])
def test_a_cut_mat_file_ends_in_a_sentence(tmp_path: Path, length: int) -> None:
    savemat(tmp_path / "a.mat", {"t": TIME_S, "theta": ANGLE_RAD})
    (tmp_path / "a.mat").write_bytes((tmp_path / "a.mat").read_bytes()[:length])
    with pytest.raises(DataError, match=r"a\.mat: (?:not readable as a MATLAB file|no arrays of numbers)"):
        read_matlab(tmp_path / "a.mat")


@pytest.mark.parametrize(("kind", "compressed"), [(8, False), (15360, True)])
def test_an_element_of_an_unknown_type_ends_in_a_sentence(tmp_path: Path, compressed: bool, kind: int) -> None:
    """Such a type makes SciPy's reader end the process that calls it."""
    plain = io.BytesIO()
    savemat(plain, {"t": TIME_S, "theta": ANGLE_RAD})
    content = bytearray(plain.getvalue())
    at = content.index(struct.pack("<II", 9, 8 * len(TIME_S)))  # the tag of an array of doubles
    content[at : at + 4] = struct.pack("<I", kind)
    if compressed:
        packed = zlib.compress(bytes(content[128:]))
        content[128:] = struct.pack("<II", 15, len(packed)) + packed
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(DataError) as refused:
        read_matlab(tmp_path / "a.mat")
    assert refused.value.code == "damaged"


def test_version_7_3_without_its_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)  # as if it were not installed
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(ConfigError, match=r'pip install "cfid\[mat\]"'):
        read_matlab(tmp_path / "a.mat")


def _columns(file: Any) -> None:
    file["t"], file["theta"] = TIME_S[None], ANGLE_RAD[None]


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


@pytest.mark.parametrize("fill", [_columns, _structure, _two_signals])
def test_version_7_3_is_read_as_version_5(tmp_path: Path, fill: Callable[[Any], None]) -> None:
    h5py = pytest.importorskip("h5py", reason='h5py comes with pip install "cfid[mat]"')
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        fill(file)
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\x02IM")
    time_s, angle_rad = angle_in(tmp_path / "a.mat", How())
    np.testing.assert_array_equal(angle_rad, ANGLE_RAD)
    np.testing.assert_allclose(time_s, TIME_S, atol=1e-14)
