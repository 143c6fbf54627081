"""Records the load cell: reads and sets its box over HTTP, requests a stream, and times it by the box' own count."""

from collections.abc import Mapping
from contextlib import ExitStack
from http import HTTPStatus
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DeviceError
from cfid.records.rig_file import LoadCellBox, LoadCellLines
from cfid.records.run import DeviceRecord
from cfid.rig.clock import Array, SampleClock
from cfid.rig.hardware import Address, DatagramPort, Hardware
from cfid.rig.instrument import Block, Instrument, Say, Silence
from cfid.rig.lock import DeviceLock
from cfid.rig.progress import vertical_force
from cfid.rig.text_lines import TextLines, ready_lines
from cfid.wire import netft, rdt
from cfid.wire.rdt_order import RecordOrder
from cfid.wire.rdt_status import read_status

COLUMNS = ("t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "rdt_sequence", "ft_sequence", "status")
RECEIVE_BUFFER_BYTES = 4 << 20  # 1.4 s of single records at 7 kHz; the usual buffer holds 37 ms


_SILENT_S = 1.0  # without a record: then the stream is requested again
_BROKEN_S = 0.4  # without a record while motors run, after which they are stopped
_ABSENT_S = 3.0  # of silence at the start, after which the stream is given up
_DEAD_S = 10.0  # of silence later on, which leaves time to plug a cable in again
_STOPS = 5
# Settings of the box that stand beside them in run.toml, or that no fit asks for.
_BESIDE = {"force_unit", "torque_unit", "rdt_enabled", "rate_hz"}


def resolved(box: LoadCellBox, hardware: Hardware) -> LoadCellBox:
    """Return the box with its numeric address, which is the source of its datagrams.

    Raises DeviceError when the address does not exist.
    """
    number = hardware.host(box.address)
    if not number:
        raise DeviceError(
            f"'{box.address}' is no address in this network: set devices.loadcell.address in rig.toml to the box' own, "
            f"{netft.DEFAULT_ADDRESS} as delivered."
        )
    return box.model_copy(update={"address": number})


def read_settings(box: LoadCellBox, hardware: Hardware) -> netft.Settings:
    """Return the box' active configuration.

    Raises DeviceError when the box does not answer, or its page is invalid.
    """
    try:
        index = netft.active_configuration(_page(box, hardware, netft.configuration_query(0)))
        return netft.read_settings(_page(box, hardware, netft.configuration_query(index)))
    except ValueError as error:
        raise DeviceError(
            f"http://{box.address}:{box.http_port}{netft.CONFIGURATION_PATH}: {error}. Is {box.address} a Net F/T? "
            "Open its web page to see."
        ) from None


def set_rate(box: LoadCellBox, hardware: Hardware) -> netft.Settings:
    """Set the box' rate and its records per datagram; return its settings as read back.

    Raises DeviceError when the box keeps other settings.
    """
    size = buffer_size(box.rate_hz)
    before = read_settings(box, hardware)
    if before.rate_hz == box.rate_hz and before.rdt_enabled and before.buffer_size == size:
        return before
    _page(box, hardware, netft.rate_query(rate_hz=box.rate_hz, buffer_size=size))
    after = read_settings(box, hardware)
    if not after.rdt_enabled:
        raise DeviceError(f"{box.address}: RDT is off and stays off: enable it on the box' web page, Communications.")
    if after.rate_hz != box.rate_hz or after.buffer_size != size:
        raise DeviceError(
            f"{box.address}: set to {box.rate_hz} Hz and {size} records a datagram, the box keeps "
            f"{after.rate_hz} Hz and {after.buffer_size}. Its rates are {netft.FASTEST_HZ}/n Hz: set "
            f"devices.loadcell.rate_hz in rig.toml to such a rate, {after.rate_hz} for instance."
        )
    return after


async def take_bias(box: LoadCellBox, hardware: Hardware) -> bool:
    """Bias the box to the present load; return whether its settings then show another bias than before.

    The box does not answer this request, which ends the stream: only the holder of the box may send it. Raises
    DeviceError when the box is out of reach.
    """
    before = read_settings(box, hardware).bias
    port = hardware.datagrams((box.address, box.rdt_port), lambda *_: None)
    try:
        for _ in range(3):
            port.send(rdt.encode_request(rdt.Request(rdt.Command.BIAS)))
            await hardware.sleep(0.1)
            if read_settings(box, hardware).bias != before:
                return True
    finally:
        port.close()
    return False


def buffer_size(rate_hz: float) -> int:
    """Return how many records a datagram should hold, so that none waits long in the box."""
    return max(1, min(40, round(rate_hz * 0.02)))


def read_once(box: LoadCellBox, hardware: Hardware) -> netft.LoadReading:
    """Return a single reading over TCP. Raises DeviceError."""
    answer = hardware.exchange((box.address, box.tcp_port), netft.READ_FORCES, netft.READING_BYTES)
    try:
        return netft.read_reading(answer)
    except ValueError as error:
        raise DeviceError(f"{box.address} TCP {box.tcp_port}: {error}.") from None


def _page(box: LoadCellBox, hardware: Hardware, path: str) -> str:
    status, text = hardware.page((box.address, box.http_port), path)
    if status != HTTPStatus.OK:
        raise DeviceError(
            f"http://{box.address}:{box.http_port}{path}: answers {status}, where a Net F/T has its settings: "
            "another device."
        )
    return text


def ready_loadcell(
    setting: LoadCellBox | LoadCellLines,
    hardware: Hardware,
    held: ExitStack,
    *,
    bias: bool = False,
    say: Say,
    patient: bool = True,
) -> "LoadCell | TextLines":
    """Lock the load cell, of whichever kind, set a box' rate and read its settings.

    Without `patient` the run ends as its stream breaks off. Raises ConfigError or DeviceError.
    """
    if isinstance(setting, LoadCellLines):
        if bias:
            raise ConfigError("`bias`: only a Net F/T box has a bias; fits take the zero from pauses.")
        return ready_lines("loadcell", setting, hardware, held, say=say, patient=patient)
    box = resolved(setting, hardware)
    where = f"{box.address}:{box.rdt_port}"
    held.enter_context(DeviceLock(where))
    if bias and not hardware.run(lambda _: take_bias(box, hardware)):
        say(f"{where}: the box' page still shows the earlier bias. Check that the load reads zero now.")
    return LoadCell(box, set_rate(box, hardware), biased=bias, say=say, patient=patient)


class Inbox:
    """Datagrams from one address, end to end, with the arrival time of each; others are counted and dropped."""

    def __init__(self, source: Address) -> None:
        """Take the address of the box."""
        self.foreign = self.malformed = 0
        self._source = source
        self.data = bytearray()
        self.ends: list[int] = []
        self.arrivals_s: list[float] = []

    def add(self, datagram: bytes, source: Address, arrival_s: float) -> None:
        """Take a datagram."""
        if source != self._source:
            self.foreign += 1
        elif not rdt.is_block(len(datagram)):
            self.malformed += 1
        else:
            self.data += datagram
            self.ends.append(len(self.data) // rdt.RECORD_BYTES - 1)
            self.arrivals_s.append(arrival_s)

    def take(self) -> tuple[rdt.Records, npt.NDArray[np.intp], Array]:
        """Return the new records, which of them ended a datagram, and when each of those arrived."""
        taken = rdt.decode_records(self.data), np.array(self.ends, np.intp), np.array(self.arrivals_s)
        self.data = bytearray()
        self.ends, self.arrivals_s = [], []
        return taken


class LoadCell(Instrument):
    """The stream of a load cell's box, which answers only one client at a time.

    Without `patient` a stream that breaks off ends the run at once, as it must while motors run.
    """

    name = "loadcell"

    def __init__(self, box: LoadCellBox, settings: netft.Settings, *, biased: bool, say: Say, patient: bool) -> None:
        """Take the box, locked, and its settings as read."""
        self._address = (box.address, box.rdt_port)
        self._settings = settings
        self._where = f"{box.address}:{box.rdt_port}"
        self._patient, self._say = patient, say
        self.record = DeviceRecord.model_validate(
            {
                "file": "loadcell.csv",
                "columns": COLUMNS,
                "counts_per_n": settings.counts_per_n,
                "counts_per_nm": settings.counts_per_nm,
                "asked": "buffered",
                "rate_hz": settings.rate_hz,
                "biased": biased,
                "address": self._where,
                "settings": {name: value for name, value in settings._asdict().items() if name not in _BESIDE},
            }
        )
        self.reading = vertical_force(settings.counts_per_n)
        self._datagram_s = settings.buffer_size / settings.rate_hz

    def start(self, hardware: Hardware) -> None:
        """Open a port and request the stream."""
        self._hardware = hardware
        self._inbox = Inbox(self._address)
        self._order = RecordOrder()
        self._samples: SampleClock | None = None  # once the step of the count is known
        self._rate_hz = float(self._settings.rate_hz)
        self._last_ft: int | None = None
        self._last_s = -np.inf
        self._missing = self._counted = 0
        self._warned: set[str] = set()
        self._is_given_up = False
        self._silence = Silence(hardware, period_s=self._datagram_s)
        self._port: DatagramPort = hardware.datagrams(self._address, self._inbox.add)
        if self._port.buffer_bytes < RECEIVE_BUFFER_BYTES:
            self._say(
                f"the system caps the receive buffer at {self._port.buffer_bytes >> 10} KiB where "
                f"{RECEIVE_BUFFER_BYTES >> 10} are needed: a busy computer may lose samples. "
                f"`sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` allows them."
            )
        self._is_streaming = True
        self._request()

    def take(self) -> Block:
        """Return the new records, in order and timed by the box' own count."""
        self._port.drain()
        every, ends, arrivals_s = self._inbox.take()
        records = self._order.take(every)
        if not len(records):
            self._check_silence()
            return self.block((), self._newly_lost())
        assert self._order.step is not None  # once records were taken
        if self._samples is None:
            ticks_per_s = _ticks_per_s(self._rate_hz, self._order.step)
            self._samples, self._rate_hz = SampleClock(ticks_per_s=ticks_per_s), ticks_per_s / self._order.step
        arrived, arrival_s = _arrivals(records, every["ft_sequence"][ends], arrivals_s)
        if self._last_ft is not None:
            self._resume(records, arrived, arrival_s)
        self._silence.end(
            "no record came" if self._last_ft is not None else "", first_s=min(arrivals_s, default=np.inf)
        )
        instants_s = self._instants_s(records, arrived, arrival_s)
        self._is_first, self._last_ft = False, int(records["ft_sequence"][-1])
        columns = (
            self._hardware.unix_times_s(instants_s),
            *records["counts"].T,
            records["rdt_sequence"],
            records["ft_sequence"],
            records["status"],
        )
        return Block(columns, self._newly_lost(), self._fault(records["status"]))

    async def stop(self) -> None:
        """Ask the box to stop until it is quiet; report a box that does not stop.

        Raises DeviceError when the box had fallen silent already: the recording has no end then.
        """
        self._is_streaming = False
        self._port.drain()
        silent_s = 0.0 if self._inbox.ends else self._silence.seconds
        if self._last_ft is not None and silent_s and self._silence.end("silent at the end"):
            self._missing += round(silent_s * self._rate_hz)
        await self._quieten()
        if self._last_ft is not None and silent_s > self._longest(_SILENT_S) and not self._is_given_up:
            raise DeviceError(self._described_silence(silent_s))

    async def _quieten(self) -> None:
        """Ask the box to stop, at least twice, until it has been silent for the time of two datagrams."""
        # A full buffer takes the box 20 ms.
        needed_s = max(0.03, 2 * self._datagram_s)
        every_s = min(needed_s, 1.4 / _STOPS)
        quiet_s = 0.0
        for request in range(_STOPS):
            arrived = len(self._inbox.ends)
            self._port.send(rdt.encode_request(rdt.Request(rdt.Command.STOP)))
            await self._hardware.sleep(every_s)
            self._port.drain()
            quiet_s = quiet_s + every_s if len(self._inbox.ends) == arrived else 0.0
            if request and quiet_s >= needed_s:
                return
        if not quiet_s:
            self._say(f"{self._where} keeps streaming after {_STOPS} requests to stop: switch it off and on.")

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, gaps, and the clock."""
        arrivals = self._order.arrivals
        return {
            "arrivals": {
                "lost": arrivals.lost + self._missing,
                "late": arrivals.late,
                "reordered": arrivals.reordered,
                "duplicates": arrivals.duplicates,
                "rejected": arrivals.rejected,
                "malformed_datagrams": self._inbox.malformed,
                "foreign_datagrams": self._inbox.foreign,
                "datagrams_dropped_by_this_computer": self._port.overflowed,
            },
            "gaps": self._silence.gaps,
            "receive_buffer_bytes": self._port.buffer_bytes,
            "said": sorted(self._warned),
        }

    def _request(self) -> None:
        self._order.begin()
        self._is_first = True
        self._requested_s = self._hardware.seconds()
        self._port.send(rdt.encode_request(rdt.Request(rdt.Command.BUFFERED)))

    def _newly_lost(self) -> int:
        lost = self._order.arrivals.lost + self._missing
        newly, self._counted = lost - self._counted, lost
        return newly

    def _longest(self, usual_s: float) -> float:
        """Return how long a silence may be before it is significant: at least four datagrams."""
        return max(usual_s, 4 * self._datagram_s)

    def _check_silence(self) -> None:
        """Request again a stream that broke off. Raises DeviceError for one that does not return, or may not break."""
        if not self._is_streaming:
            return
        silent_s, begun = self._silence.seconds, self._last_ft is not None
        longest_s = _BROKEN_S if begun and not self._patient else _DEAD_S if begun else _ABSENT_S
        if silent_s > self._longest(longest_s):
            self._is_given_up = True
            raise DeviceError(self._described_silence(silent_s))
        if min(silent_s, self._hardware.seconds() - self._requested_s) > self._longest(_SILENT_S):
            if begun and not self._is_first:
                self._say(f"{self._where} is silent; requesting the stream again")
            self._request()

    def _described_silence(self, silent_s: float) -> str:
        unread = {
            "datagrams from other addresses": self._inbox.foreign,
            "datagrams that are no records": self._inbox.malformed,
            "records that contradict the stream": self._order.arrivals.rejected,
        }
        others = "".join(f" {count} {name} came." for name, count in unread.items() if count)
        what = "sent nothing" if self._last_ft is None else f"sent nothing more for {silent_s:.1f} s"
        requested = ", despite repeated requests" if self._patient else ""
        return (
            f"{self._where} {what}{requested}.{others} Likely causes: no power, no network, another client, or a "
            "firewall that blocks UDP. `cfid rig check` finds which."
        )

    def _resume(self, records: rdt.Records, arrived: npt.NDArray[np.intp], arrival_s: Array) -> None:
        """Begin anew with a count that contradicts the arrivals; else count what the box took before a new request."""
        assert self._samples is not None and self._order.step is not None
        record, at_s = (arrived[0], arrival_s[0]) if len(arrived) else (-1, self._hardware.seconds())
        if abs(at_s - self._samples.predicted_s(int(records["ft_sequence"][record]))) > 0.2:
            self._samples.restart()
            reason = "the box was restarted"
        elif self._is_first:
            passed = (int(records["ft_sequence"][0]) - int(self._last_ft or 0)) % (1 << 32)
            self._missing += max(passed // self._order.step - int(records["rdt_sequence"][0]), 0)
            reason = "the stream broke off"
        else:
            return
        silent_s = self._silence.seconds
        self._silence.end(reason)
        self._say(f"{self._where}: {reason}; records again after {silent_s:.1f} s")

    def _instants_s(self, records: rdt.Records, arrived: npt.NDArray[np.intp], arrival_s: Array) -> Array:
        """Return when records in order were sampled; they never decrease."""
        assert self._samples is not None
        instants_s = self._samples.instants_s(
            records["ft_sequence"], arrived=arrived, arrival_s=arrival_s, read_s=self._hardware.seconds()
        )
        if instants_s[0] <= self._last_s:  # the anchor after a restart may lie before the end of the gap
            instants_s = instants_s + (self._last_s + 1e-6 - instants_s[0])
        self._last_s = float(instants_s[-1])
        return instants_s

    def _fault(self, status: npt.NDArray[np.uint32]) -> str:
        """Report each warning once; return the fault that ends the run, empty for none."""
        word = int(np.bitwise_or.reduce(status))
        if not word:
            return ""
        read = read_status(word, self._settings.family)
        for warning in read.warnings:
            if warning not in self._warned:
                self._warned.add(warning)
                self._say(f"{self._where}: {warning} (status {word:#010x}); not a fault: the recording goes on")
        if not read.faults:
            return ""
        return f"{self._where}: {', '.join(read.faults)}: the readings from here on are not forces."


def _arrivals(
    records: rdt.Records, ended: npt.NDArray[np.uint32], arrival_s: Array
) -> tuple[npt.NDArray[np.intp], Array]:
    """Find the ends of datagrams among records in order; `ended` (m,) are their ft_sequence in order of arrival."""
    first = records["ft_sequence"][0]
    passed, passed_at_end = records["ft_sequence"] - first, ended - first
    place = np.searchsorted(passed, passed_at_end).clip(max=len(passed) - 1)
    is_there = passed[place] == passed_at_end
    return place[is_there], arrival_s[is_there]


def _ticks_per_s(rate_hz: float, step: int) -> float:
    """Return the counts of ft_sequence per second: a Net F/T's 7000, unless no rounding of the rate explains that.

    The box states the rate in whole hertz: 7000/3 as 2333.
    """
    rounded = (rate_hz - 1) * step < rdt.INTERNAL_HZ < (rate_hz + 1) * step
    return float(rdt.INTERNAL_HZ if rounded else rate_hz * step)
