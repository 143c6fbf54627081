"""Every reader with valid files or packets, which the fuzzer damages."""

import io
import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from scipy.io import savemat

from cfid.drag.data import read_wind_index
from cfid.errors import CfidError, DataError
from cfid.recordings.angle import angle_of
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How, Kind, Recording
from cfid.recordings.sines import read_crossings, read_pings
from cfid.recordings.stand import stand_of
from cfid.recordings.wrench import wrench_of
from cfid.records.campaign import open_campaign
from cfid.records.files import FITS_FOLDER, RIG_FILE, RUN_FILE
from cfid.records.fits import keep_fit, list_fits
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import read_run
from cfid.report.build import build
from cfid.report.render import rendered
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import NetFTBox
from cfid.sim.truth import load_truth
from cfid.wire import app, crtp, e201, netft, rdt, scales, supervisor, ut372
from tests.logs.autopilot_bytes import blackbox, ulog
from tests.logs.usd_bytes import single
from tests.records.test_fits import FIT
from tests.report.fits_by_hand import NOON


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A function that reads a file (or the bytes of a packet), contents that it accepts, and errors that it may raise.

    `fault` returns what is wrong with the result of reading given content, or "" if no fault is known.
    """

    name: str
    contents: tuple[bytes, ...]
    read: Callable[[Path], Any]
    raises: tuple[type[Exception], ...] = (CfidError,)
    file: str = "recording.csv"
    repaired: Callable[[bytes], bytes] = bytes
    fault: Callable[[bytes, Any], str] = lambda content, found: ""


def _packet(name: str, contents: Iterable[bytes], read: Callable[[bytes], Any], *raises: type[Exception]) -> Reader:
    return Reader(name=name, contents=tuple(contents), read=lambda path: read(path.read_bytes()), raises=raises)


ROWS = 60
TIME_S = np.arange(ROWS) / 100
ANGLES = np.round(4000 * np.cos(6 * TIME_S)).astype(int)


def _lines(head: str, *columns: Iterable[Any]) -> bytes:
    rows = (",".join(map(str, row)) for row in zip(*columns, strict=True))
    return "\n".join([head, *rows, ""]).encode()


ANGLE = _lines("t,phi", TIME_S, ANGLES)
WRENCH = _lines("t,Fx [N],Fy [N],Fz [N],Tx [Nm],Ty [Nm],Tz [Nm]", TIME_S, *(ANGLES + axis for axis in range(6)))
CROSSINGS = _lines("t,thrust_rec,sample,vehicle_us", TIME_S, 100 * (1 + np.arange(ROWS)), range(ROWS), range(ROWS))
PINGS = _lines("t,rtt_s,vehicle_us", TIME_S, 0.01 + TIME_S / 100, range(0, 10000 * ROWS, 10000))
SEMICOLONS = ANGLE.replace(b",", b";").replace(b".", b",").replace(b"\n", b"\r\n")
STAND = _lines("Time (s),ESC signal (us),Thrust (gf),Voltage (V)", TIME_S, 1000 + ANGLES % 900, ANGLES, TIME_S + 12)
INDEX = (
    b"command,angle_deg,wind_min_mps,wind_max_mps,tach_rpm,loadcell,from_s,to_s\n"
    b"30000,0,2.4,2.6,14000,a.csv,1,9\n30000,45,2.4,2.6,,b.csv,,\n"
)


def _matlab() -> bytes:
    file = io.BytesIO()
    savemat(file, {"t": TIME_S[:, None], "phi": ANGLES[:, None].astype(float)})
    return file.getvalue()


def _written(write: Callable[[Path], Any]) -> bytes:
    """Return the content of the only file that a function writes into a folder."""
    with TemporaryDirectory() as folder:
        write(Path(folder))
        (path,) = (path for path in Path(folder).rglob("*") if path.is_file())
        return path.read_bytes()


RUN = b"""format = 1
kind = "swing"
started = 2026-11-21T18:49:50+01:00
state = "complete"
cfid_version = "0.2.0"
simulated = true
[label]
axis = "x"
note = "first"
[asked]
for_s = 20.0
[devices.encoder]
file = "encoder.csv"
columns = ["t", "phi"]
counts_per_turn = 4194304
rows = 60
lost = 0
skipped = 2
rate_hz = 100.0
[devices.encoder.arrivals]
errors = 0
"""


ANGLE_COUNTS = How(units={"phi": "counts"}, counts_per_turn=4096.0)


def _read(path: Path, kind: Kind | None = None, how: How | None = None) -> Recording:
    return read_recording(path, how, kind=kind)


def _angle(path: Path, decimal: Literal[".", ","] = ".") -> Any:
    how = replace(ANGLE_COUNTS, decimal=decimal)
    return angle_of(read_recording(path, how, kind="angle"), how)


def _run_frame(path: Path) -> Any:
    (path.parent / "encoder.csv").write_bytes(ANGLE)
    return angle_of(read_recording(read_run(path.parent).folder))


def _page() -> bytes:
    cell = SimulatedLoadCell(LoadCellTruth(), np.random.default_rng(1))
    return NetFTBox(load_cell=cell, plant=lambda time_s: np.zeros((len(time_s), 6)), rate_hz=7000).page().encode()


def _other_numbers(content: bytes, found: Any) -> str:
    """Compare a table with the numbers in its text, if this text is as plain as cfid's own: commas and a header."""
    try:
        lines = content.decode("ascii").split("\n")
        plain = [[float(field) for field in line.split(",")] for line in lines[1:] if line]
    except ValueError:
        return ""
    spelt = {"nan", "inf", "infinity", "_", "\r", "\x0b", "\x0c", "\x1c", "\x1d", "\x1e", "\x85"}
    rectangular = plain and {len(row) for row in plain} == {2} and lines[0] == "t,phi" and not lines[-1]
    if not rectangular or any(sign in content.decode("ascii").lower() for sign in spelt) or b"\0" in content:
        return ""
    shown, begin_s = np.array(plain), found.begin_s or 0.0
    read = np.column_stack([found.frame()["t"] + begin_s, found.column("phi").values])
    return "" if np.allclose(read, shown, rtol=1e-12, atol=1e-12) else f"read as {read!r}"


def _with_checksum(content: bytes) -> bytes:
    return content[:-4] + struct.pack("<I", zlib.crc32(content[:-4]))


def _unnoticed(content: bytes, log: Recording) -> str:
    """Return a sentence if a log with a wrong checksum was read without a note, else ""."""
    whole = len(content) > 4 and content == _with_checksum(content)
    return "" if whole or log.findings else "its checksum is wrong, and no finding says so"


def _all_values(recording: Recording) -> Recording:
    for series in recording.series.values():
        _ = series.frame()
    return recording


def _all_fits(path: Path) -> Any:
    (found,) = list_fits(path.parent)
    if isinstance(found, CfidError):
        raise found
    return found


QUALITY = {
    "rms": 0.5,
    "common_causes": {"drag.complex.k1": {"fit": [1e-9, 2e-9], "tachometer": [3e-9, None]}},
    "budget_kg_m2": {"mass": np.eye(3).tolist()},
    "models": {"simple": {"rms": 1.0}},
    "swings": [{"run": "a", "window_s": [0.0, 9.0], "verdict": "good"}],
    "series": [{"clock_skew": 1e-6}],
    "verification_gain": 1.0,
    "verification_gain_std": 0.1,
}


def _reported(path: Path) -> Any:
    folder = path.parent
    (folder / FITS_FOLDER).mkdir(exist_ok=True)
    (folder / RIG_FILE).write_text(new_rig_text())
    (folder / FITS_FOLDER / "fit.json").write_bytes(path.read_bytes())
    report = build(open_campaign(folder), now=NOON)
    if report["unreadable"]:
        raise DataError(" ".join(report["unreadable"]))
    return [rendered(report, form, folder) for form in ("html", "md", "tex", "json")]


def _not_as_sent(content: bytes, found: rdt.Records) -> str:
    return "" if rdt.encode_records(found) == content else "records are not those of the bytes"


def _decoders(payload: bytes) -> Any:
    """Let every decoder of the vehicle's packets read a payload; each returns None for a payload of another kind."""
    for decode in (
        app.decode_thrust_answer, app.decode_sine_answer, app.decode_crossing,
        app.decode_done, app.decode_hello, app.decode_state, crtp.decode_packet, crtp.decode_echo,
        crtp.decode_log_answer, supervisor.decode_state, rdt.decode_request, ut372.unpack_report,
    ):  # fmt: skip
        decode(payload)


READERS = (
    Reader(
        name="table",
        contents=(ANGLE,),
        read=lambda path: read_recording(path, ANGLE_COUNTS, kind="angle").series["recording"],
        fault=_other_numbers,
    ),
    Reader(name="angle", contents=(ANGLE,), read=_angle),
    Reader(name="angle, decimal commas", contents=(SEMICOLONS,), read=lambda path: _angle(path, ",")),
    Reader(name="MATLAB", contents=(_matlab(),), read=_angle, file="swing.mat"),
    Reader(name="wrench", contents=(WRENCH,), read=lambda path: wrench_of(_read(path, "wrench"))),
    Reader(name="crossings", contents=(CROSSINGS,), read=read_crossings),
    Reader(name="pings", contents=(PINGS,), read=read_pings),
    Reader(name="stand", contents=(STAND,), read=lambda path: stand_of(_read(path, "stand"))),
    Reader(name="any table", contents=(ANGLE, WRENCH, STAND), read=lambda path: _all_values(_read(path))),
    Reader(
        name="uSD-card log",
        contents=(single(40),),
        read=lambda path: _all_values(_read(path, how=How(clock="true"))),
        fault=_unnoticed,
    ),
    Reader(
        name="uSD-card log, checksum right",
        contents=(single(40),),
        read=lambda path: _all_values(_read(path, how=How(clock="true"))),
        repaired=_with_checksum,
    ),
    Reader(name="ULog", contents=(ulog(), ulog(geometry="FR RL FL RR")), read=lambda path: _all_values(_read(path))),
    Reader(name="blackbox", contents=(blackbox(),), read=lambda path: _all_values(_read(path))),
    Reader(name="wind index", contents=(INDEX,), read=read_wind_index),
    Reader(name="run.toml", contents=(RUN,), read=_run_frame, file=RUN_FILE),
    Reader(name="rig.toml", contents=(new_rig_text().encode(),), read=load_rig, file="rig.toml"),
    Reader(name="fit", contents=(_written(lambda folder: keep_fit(folder, FIT)),), read=_all_fits, file="fit.json"),
    Reader(
        name="report of a fit",
        contents=(_written(lambda folder: keep_fit(folder, replace(FIT, quality=QUALITY))),),
        read=_reported,
    ),
    Reader(name="truth file", contents=(b'[battery]\nkind = "lipo"\n[radio]\nloss = 0.01\n',), read=load_truth),
    _packet("page of the box", [_page()], lambda data: netft.read_settings(data.decode(errors="replace")), ValueError),
    _packet(
        "reading of the box", [netft.encode_reading(netft.LoadReading(1, (1,) * 6))], netft.read_reading, ValueError
    ),
    Reader(
        name="records of the box",
        contents=(bytes(range(36)) * 4,),
        raises=(ValueError,),
        fault=_not_as_sent,
        read=lambda path: rdt.decode_records(path.read_bytes()),
    ),
    _packet("E201", [b"12345:678\r" * 5 + b"E201Q\r"], lambda data: e201.PositionReader(word_bits=22).feed(data)),
    _packet("scales", [b"S S   12.34 g\r\n" * 4], lambda data: scales.ScalesReader().feed(data)),
    _packet("UT372", [bytes(range(0x30, 0x40)) * 4 + b"\r\n"], lambda data: ut372.Ut372Reader().feed(data)),
    _packet("packets of the vehicle", [bytes(range(31))], _decoders),
)
