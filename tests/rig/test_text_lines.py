"""Devices that send text: each whole line is a row, and every other line is counted, by the device's clock or rate."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError, DeviceError
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import wrench_of
from cfid.records.rig_file import EncoderLines, LineDevice, LineValue, LoadCellLines
from cfid.rig.check import check_lines
from cfid.rig.lock import DeviceLock
from cfid.rig.text_lines import ready_lines
from tests.lab import known
from tests.virtual_lab import Board, Lab, Recorded, recorded

CELL = LoadCellLines(
    kind="lines",
    port="port",
    rate_hz=80,
    values=(LineValue(name="device_us"), LineValue(name="Fz", unit="g", scale=0.5)),
)
CLOCKLESS = CELL.model_copy(update={"values": CELL.values[1:]})
G = 9.80665e-3  # newtons per gram
PERIOD_US = 12500
Lines = Callable[[int], bytes]


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


def line(n: int) -> bytes:
    """Return a line whose force numbers it, with a clock that wraps after a few lines."""
    return b"%d,%d\r\n" % ((PERIOD_US * n + 4_294_000_000) % 2**32, n)


def ticking(ticks_us: Callable[[int], int]) -> Lines:
    return lambda n: b"%d,%d\r\n" % (ticks_us(n) % 2**32, n)


def but(places: Collection[int], sent: Lines, instead: Lines = lambda n: b"") -> Lines:
    """Return the lines, with others at some places."""
    return lambda n: (instead if n in places else sent)(n)


@contextmanager
def plugged(lab: Lab, sent: Lines, setting: LineDevice, *, every: float = 1.0) -> Iterator[LineDevice]:
    """Plug in a board that sends at the stated rate, in pieces of `every` lines; yield its setting."""
    board = Board(sent, rate_hz=setting.rate_hz / every)
    yield setting.model_copy(update={"port": lab.plug_in(board, f"{lab.port}-board")})


class Log(Recorded):
    """A recording of a device that sends lines; things happen `at` seconds from its start."""

    def __init__(
        self,
        lab: Lab,
        sent: Lines,
        *,
        setting: LineDevice = CELL,
        for_s: float | None = 5.0,
        patient: bool = True,
        every: float = 1.0,
        at: dict[float, Callable[[], object]] | None = None,
        **options: Any,
    ) -> None:
        with plugged(lab, sent, setting, every=every) as plugged_in, ExitStack() as held:
            name = "loadcell" if isinstance(setting, LoadCellLines) else "encoder"
            said: list[str] = []
            device = ready_lines(name, plugged_in, lab.hardware, held, say=said.append, patient=patient, **options)
            for seconds, act in (at or {}).items():
                lab.hardware.at(seconds, act)
            begun_s = lab.hardware.seconds()
            run, self.error, _ = recorded(lab.hardware, lab.folder, device, for_s=for_s)
        self.said, self.took_s = said, lab.hardware.seconds() - begun_s
        super().__init__(run, name, begun_s=begun_s)

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """The numbers of the lines that are rows."""
        numbers: npt.NDArray[np.int64] = np.rint(self.rows["Fz"].to_numpy() / (0.5 * G)).astype(np.int64)
        return numbers

    @property
    def missing(self) -> int:
        """How many lines between the first and the last row are no rows."""
        return int(np.ptp(self.numbers)) + 1 - len(self.rows)


# Rows


def test_lines_are_rows_in_newtons_with_the_devices_clock_unwrapped(lab: Lab) -> None:
    log = Log(lab, line)

    assert log.error is None
    assert list(log.rows.columns) == ["t", "Fz", "device_us"]
    assert log.numbers.tolist() == list(range(1, len(log.rows) + 1))
    assert log.rows["Fz"].to_numpy() == pytest.approx(0.5 * G * log.numbers)
    assert set(np.diff(log.rows["device_us"])) == {PERIOD_US}
    assert log.times_s == pytest.approx(log.numbers / 80, abs=0.003)
    assert (log.lost, log.reasons, log.said) == (0, [], [])
    assert not log.losses
    assert (log.facts["units"], log.facts["lines"]["values"][1]) == ("n,nm", {"name": "Fz", "unit": "g", "scale": 0.5})
    wrench = wrench_of(read_recording(log.run.folder))
    assert wrench.axes == ("Fz",)
    assert np.isnan(wrench.torque_nm).all()


def test_half_lines_junk_and_many_lines_at_once_leave_only_whole_lines(lab: Lab) -> None:
    """The first line has lost its beginning, the last its end; junk lies between."""
    pieces = [b"999,9", b"99\r\n", *(part for n in range(40) for part in (line(n)[:4], line(n)[4:]))]
    pieces += [b"\xff\xfe\x00\x1b[2J\r\n" + b"5" * 1500 + b"\r\n", b"".join(map(line, range(40, 140))), line(200)[:-3]]
    log = Log(lab, lambda n: pieces[n] if n < len(pieces) else b"", for_s=1.2)

    assert log.numbers.tolist() == list(range(140))
    assert log.lost == log.losses["lines_that_do_not_match"] == 2


def test_an_angle_is_a_column_in_counts_of_the_stated_turn_or_in_radians(lab: Lab, tmp_path: Path) -> None:
    def encoder(unit: str) -> EncoderLines:
        return EncoderLines(kind="lines", port="p", rate_hz=500, values=(LineValue(name="phi", unit=unit),))

    in_counts = Log(lab, lambda n: b"%d\n" % (n % 4096), setting=encoder("counts"), counts_per_turn=4096, for_s=1)
    (tmp_path / "other").mkdir()
    in_degrees = Log(Lab(tmp_path / "other"), lambda n: b"%d\n" % (n % 360), setting=encoder("deg"), for_s=1)

    assert in_counts.rows["phi"].max() > 400
    assert in_counts.device.counts_per_turn == 4096
    assert in_degrees.rows["phi"].max() == pytest.approx(2 * np.pi, abs=0.02)
    with pytest.raises(ConfigError, match="counts_per_turn"):
        Log(lab, line, setting=encoder("counts"), counts_per_turn="rls-13bit-in-22")


# Losses


@pytest.mark.parametrize("setting", [CELL, CLOCKLESS], ids=["by its clock", "by the stated rate"])
@pytest.mark.parametrize("loss", [0.1, 0.4])
def test_the_counted_loss_is_the_true_one(lab: Lab, loss: float, setting: LoadCellLines) -> None:
    """The clock, and the lines, are 3 % quicker than stated where the device sends one: the count is exact even so."""
    gone = set(np.flatnonzero(np.random.default_rng(round(100 * loss)).random(1200) < loss).tolist())
    if setting is CELL:
        log = Log(lab, but(gone, ticking(lambda n: round(PERIOD_US * n / 1.03))), for_s=12.5, every=1 / 1.03)
    else:
        log = Log(lab, but(gone, lambda n: b"%d\n" % n), setting=setting, for_s=12.5)
    (listed,) = json.loads(lab.cfid("runs", "--json").out)["runs"]

    assert log.missing == pytest.approx(loss * 1000, rel=0.25)
    assert log.lost == pytest.approx(log.missing, abs=0 if setting is CELL else 0.1 * 80)
    assert listed["lost"] == log.lost
    assert log.said == []


def test_losses_are_unknown_where_more_lines_come_than_rig_toml_states(lab: Lab) -> None:
    log = Log(lab, lambda n: b"%d\n" % n, setting=CLOCKLESS, every=1 / 1.2)

    assert log.lost is None
    assert 'lost = "unknown"' in (log.run.folder / "run.toml").read_text()
    assert json.loads(lab.cfid("runs", "--json").out)["runs"][0]["lost"] == "?"
    assert "rate_hz" in log.said[0]


@pytest.mark.parametrize("torn", [b"\x1b]0;\x07no\r\n", b"7,8,9\r\n"])
def test_lines_that_do_not_match_are_lost_and_comment_no_rate(lab: Lab, torn: bytes) -> None:
    log = Log(lab, but(range(0, 1000, 3), line, lambda n: torn))

    assert log.error is None
    assert log.lost == log.losses["lines_that_do_not_match"] == pytest.approx(133, abs=2)
    assert log.missing == pytest.approx(log.lost, abs=1)
    assert not any("rate_hz" in text for text in log.said)


@pytest.mark.parametrize("false", [[1], [40, 41], [40, 42]])
def test_lines_whose_clock_jumps_there_and_back_are_lost(lab: Lab, false: Sequence[int]) -> None:
    log = Log(lab, but(false, line, ticking(lambda n: 3_000_000_000 - 1_000_000 * n)))

    assert sorted(set(range(1, 400)) - set(log.numbers)) == false
    assert np.ptp(log.rows["device_us"]) == PERIOD_US * np.ptp(log.numbers)
    assert log.lost == log.losses["lines_with_a_false_clock"] == len(false)


@pytest.mark.parametrize(
    ("ticks_us", "word"),
    [
        pytest.param(lambda n: PERIOD_US * n, "", id="true"),
        pytest.param(lambda n: PERIOD_US * n + 9000 * (n % 2), "", id="uneven"),
        pytest.param(lambda n: PERIOD_US * (n - n % 2), "", id="of every second line"),
        pytest.param(lambda n: PERIOD_US * (n if n < 200 else n - 200), "anew", id="restarted"),
        pytest.param(lambda n: 20 * PERIOD_US * n // 16, "went 6.", id="too quick"),
        pytest.param(lambda n: 7, "went 0 s", id="stands"),
    ],
)
def test_a_clock_that_goes_otherwise_costs_no_row_and_is_named(
    lab: Lab, ticks_us: Callable[[int], int], word: str
) -> None:
    log = Log(lab, ticking(ticks_us))

    assert log.error is None
    assert log.numbers.tolist() == list(range(1, len(log.rows) + 1))
    if word.startswith("went"):
        assert log.lost in (0, None)
    else:
        assert known(log.lost) <= 1
    assert [word in text for text in log.said] == ([True] if word else [])


def test_a_clock_in_another_unit_jumps_in_every_line_and_ends_the_run(lab: Lab) -> None:
    log = Log(lab, ticking(lambda n: 1000 * PERIOD_US * n), for_s=60)

    assert isinstance(log.error, DeviceError)
    assert "clock" in str(log.error)
    assert log.took_s < 1


# Silence, and the plug


def pull(lab: Lab) -> None:
    lab.unplug(f"{lab.port}-board")


def put_back(lab: Lab) -> None:
    lab.plug_back(f"{lab.port}-board")


class Fault(NamedTuple):
    """The places without a line, what happens at which seconds, how many lines are lost, and how the run ends."""

    gone: Collection[int] = ()
    acts: Mapping[float, Callable[[Lab], object]] = MappingProxyType({})
    lost: float = 160
    reason: str = "no line came"
    for_s: float | None = 5.0
    setting: LoadCellLines = CELL
    ended_s: float | None = None  # in which it fails
    patient: bool = True


FAULTS = {
    "a silence": Fault(range(80, 240)),
    "a silence, by the stated rate": Fault(range(80, 240), setting=CLOCKLESS),
    "a silence at the end": Fault(range(240, 9999), reason="silent at the end"),
    "a silence for good": Fault(range(80, 9999), lost=400, reason="silent at the end", for_s=None, ended_s=6.0),
    "a silence while motors run": Fault(
        range(80, 9999), lost=33, reason="silent at the end", for_s=10, ended_s=1.5, patient=False
    ),
    "a plug put back": Fault(acts={1: pull, 3: put_back}, reason="unplugged", for_s=6),
    "a plug not put back": Fault(acts={1: pull}, lost=240, reason="unplugged", for_s=4, ended_s=4.0),
    "a plug pulled while motors run": Fault(acts={1: pull}, lost=0, reason="", for_s=10, ended_s=1.0, patient=False),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_a_fault_takes_is_lost_in_a_gap_and_a_device_that_does_not_come_back_fails_the_run(
    lab: Lab, name: str
) -> None:
    fault = FAULTS[name]
    sent = but(fault.gone, line if fault.setting is CELL else lambda n: b"%d\n" % n)
    acts: dict[float, Callable[[], object]] = {at_s: partial(act, lab) for at_s, act in fault.acts.items()}
    log = Log(lab, sent, setting=fault.setting, for_s=fault.for_s, patient=fault.patient, at=acts)

    assert isinstance(log.error, DeviceError) == (fault.ended_s is not None)
    assert log.took_s == pytest.approx(fault.ended_s or fault.for_s, abs=0.2)
    assert log.reasons == [fault.reason] * bool(fault.reason)
    assert log.lost == pytest.approx(fault.lost, abs=45 if put_back in fault.acts.values() else 5)
    assert log.missing == (log.lost if fault.ended_s is None and fault.reason != "silent at the end" else 0)


@pytest.mark.parametrize("damaged", [(), (150, 151, 152), range(100, 140)])
def test_lines_that_come_in_bursts_are_lost_only_where_the_devices_clock_skips_some(
    lab: Lab, damaged: Collection[int]
) -> None:
    sent = but(damaged, line)
    log = Log(lab, lambda n: b"".join(map(sent, range(25 * n, 25 * n + 25))), every=25, for_s=4.8)

    assert log.error is None
    assert log.lost == log.missing == len(damaged)


@pytest.mark.parametrize("overflown", [0, 120])
def test_lines_that_the_computer_kept_while_the_program_stood_still_are_not_lost(lab: Lab, overflown: int) -> None:
    log = Log(lab, but(range(80, 80 + overflown), line), at={0.99: lambda: lab.hardware.stand_still(2.0)})
    (gap,) = log.gaps

    assert log.error is None
    assert gap["stood_s"] == pytest.approx(1.8, abs=0.1)
    assert log.lost == log.missing == overflown
    assert len(log.rows) == pytest.approx(5 * 80 - overflown, abs=3)


def test_the_lock_of_a_port_named_by_a_link_stays_while_the_plug_is_pulled(lab: Lab, tmp_path: Path) -> None:
    port, link = f"{lab.port}-board", tmp_path / "by-id"
    link.symlink_to(port)
    refusals = list[str]()

    def pull_link() -> None:
        lab.unplug(port)
        link.unlink()

    def take() -> None:
        with pytest.raises(DeviceError) as error:
            DeviceLock(port)
        refusals.append(str(error.value))

    with plugged(lab, line, CELL), ExitStack() as held:
        lab.hardware.ports[str(link)] = lab.hardware.ports[port]
        setting = CELL.model_copy(update={"port": str(link)})
        cell = ready_lines("loadcell", setting, lab.hardware, held, say=print)
        lab.hardware.at(1.0, pull_link)
        lab.hardware.at(2.5, take)
        recorded(lab.hardware, lab.folder, cell, for_s=3.0)

    assert "is held by" in refusals[0]


# cfid rig check


def checked(lab: Lab, sent: Lines, *, setting: LineDevice = CELL, every: float = 1.0) -> dict[str, Any]:
    """Return the answers by question."""
    with plugged(lab, sent, setting, every=every) as plugged_in:
        return {answer.asked: answer for answer in check_lines("loadcell", plugged_in, lab.hardware)}


def test_check_shows_rate_clock_and_resolution(lab: Lab) -> None:
    found = checked(lab, line)

    assert {answer.state for answer in found.values()} == {"ok"}
    assert list(found) == ["port", "lines", "device_us", "Fz"]
    assert float(found["lines"].answer.split()[0]) == pytest.approx(80, rel=0.03)
    assert "steps of 0.0049," in found["Fz"].answer


@pytest.mark.parametrize(
    ("sent", "asked", "state", "word"),
    [
        (lambda n: b"0,%d\r\n" % (301 + n), "device_us", "warning", "went 0 s"),
        (lambda n: b"\x1b[2JFz=%d\r\n" % n, "lines", "fault", "?[2JFz="),
        (lambda n: b"", "lines", "fault", "nothing came"),
        (lambda n: 2 * line(n), "lines", "warning", "160"),
    ],
    ids=["clock", "pattern", "silent", "rate"],
)
def test_check_shows_what_is_wrong(lab: Lab, sent: Lines, asked: str, state: str, word: str) -> None:
    found = checked(lab, sent)[asked]

    assert found.state == state
    assert word in found.answer
    assert found.answer.isprintable()
    assert found.advice
