"""Records what the vehicle logs: battery, motors and its other measurements, up to a row a millisecond."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from twisted.internet.defer import Deferred
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.recorder import Block, no_rows
from cfid.rig.vehicle import Vehicle
from cfid.wire import crtp
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_DATA_CHANNEL, LOG_PORT, LogCommand, Packet, Variable

BATTERY = "pm.vbat"

_BLOCK = 200  # cflib numbers its own blocks from 1
_WRAP_MS = 1 << 24
_EXISTS = 17
_SILENT_S, _SILENT_PERIODS = 0.5, 5  # without a row
_ABSENT_S = 3.0  # without a row of a log without battery, as for an encoder
_LOW_FOR_S = 0.5  # a start of the motors pulls the voltage down for a moment


class CrazyflieLog:
    """One log block of the vehicle; `t` is when a row arrived, `vehicle_ms` when the vehicle made it (it wraps)."""

    name = "crazyflie"

    def __init__(
        self,
        vehicle: Vehicle,
        names: Sequence[str],
        *,
        period_ms: int,
        stop_below_v: float | None,
        loop: Any,
        clock: HostClock,
    ) -> None:
        """Take variables that the vehicle has, 26 bytes at most; a battery below `stop_below_v` ends the run."""
        self.columns = ("t", "vehicle_ms", *names)
        self.latest: dict[str, float] = {}
        self._names, self._period_ms, self._stop_below_v = names, period_ms, stop_below_v
        self._vehicle, self._loop, self._clock = vehicle, loop, clock
        self._variables = [_found(vehicle, name) for name in names]
        self._rows: list[tuple[float, int, tuple[float, ...]]] = []
        self._last_ms: int | None = None
        self._low_since_s: float | None = None
        self._low = ""  # the fault as reported: later rows do not change it
        self._newest_ms: int | None = None
        self._rejected = self._duplicates = 0
        self._streaming, self._received_s = False, 0.0
        self._refusal: BaseException | None = None
        vehicle.listen(LOG_PORT, LOG_DATA_CHANNEL, self._take_row)

    def start(self) -> None:
        """Request the rows; a refusal shows in the next block."""
        self._vehicle.stalls.begin()
        Deferred.fromCoroutine(self._begin()).addErrback(self._refused)

    def take(self) -> Block:
        """Return the rows, with a fault when the battery is too low. Raises DeviceError when the vehicle refused."""
        if self._refusal is not None:
            raise self._refusal
        self._vehicle.stalls.note()
        rows, self._rows = self._rows, []
        if not rows:
            self._watch()
            return Block(no_rows(len(self.columns)))
        times_s = self._clock.unix_s(np.array([arrived_s for arrived_s, _, _ in rows]))
        stamps_ms = np.array([stamp_ms for _, stamp_ms, _ in rows])
        values = zip(*(row for _, _, row in rows), strict=True)
        fault = self._watch_battery(rows[-1][0])
        return Block((times_s, stamps_ms, *map(self._column, values, self._variables)), self._missing(stamps_ms), fault)

    async def stop(self) -> None:
        """End the stream, unless the vehicle is out of reach."""
        self._streaming = False
        if not self._vehicle.wire.fault:
            self._vehicle.send(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_stop_log(_BLOCK))

    def close(self) -> None:
        """Do nothing: the code that opened the link closes it."""

    def facts(self) -> Mapping[str, Any]:
        """Return how many rows were invalid, and how many were duplicates."""
        return {"losses": {"rejected": self._rejected, "duplicates": self._duplicates}}

    async def _begin(self) -> None:
        await self._control(LogCommand.CREATE, crtp.encode_create_log(_BLOCK, self._variables))
        await self._control(LogCommand.START_MS, crtp.encode_start_log(_BLOCK, self._period_ms))
        self._streaming, self._received_s = True, self._loop.seconds()

    def _refused(self, failure: Failure) -> None:
        self._refusal = failure.value

    async def _control(self, command: LogCommand, payload: bytes) -> None:
        def own(answer: bytes) -> crtp.LogAnswer | None:
            read = crtp.decode_log_answer(answer)
            return read if read and (read.command, read.block) == (command, _BLOCK) else None

        answer = await self._vehicle.ask(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, payload), own)
        if answer is None or answer.error not in (0, _EXISTS):
            reason = "no answer" if answer is None else f"error {answer.error}"
            raise DeviceError(f"{self._vehicle.uri}: the vehicle does not log {', '.join(self._names)}: {reason}.")

    def _take_row(self, payload: bytes, arrived_s: float) -> None:
        row = crtp.decode_log_row(_BLOCK, self._variables, payload)
        if not self._streaming:  # a row of an earlier run, whose stop was still on its way
            return
        if row is None:
            self._rejected += payload[:1] == bytes([_BLOCK])
            return
        if row[0] == self._newest_ms:  # datagrams may arrive twice
            self._duplicates += 1
            return
        self._newest_ms = row[0]
        self._rows.append((arrived_s, *row))
        self._received_s = arrived_s
        self.latest = dict(zip(self._names, row[1], strict=True))

    def _column(self, values: Sequence[float], variable: Variable) -> Any:
        """Return a column as the vehicle sent it: a float32 with no more digits than it has."""
        if variable.kind in "fe":
            return np.array([float(str(np.float32(value))) for value in values])
        return np.array(values, dtype=np.int64)

    def _missing(self, stamps_ms: Any) -> int:
        before = [self._last_ms, *stamps_ms[:-1]] if self._last_ms is not None else list(stamps_ms[:-1])
        after = stamps_ms[-len(before) :] if before else []
        self._last_ms = int(stamps_ms[-1])
        steps = [round((late - early) % _WRAP_MS / self._period_ms) for early, late in zip(before, after, strict=True)]
        return sum(max(step - 1, 0) for step in steps)

    def _watch(self) -> None:
        """Raise DeviceError when rows, and the voltage in them, stop coming: another client may have reset the log."""
        silent_s = self._vehicle.silent_s(self._received_s)
        monitored = BATTERY in self._names
        longest_s = max(_SILENT_S if monitored else _ABSENT_S, _SILENT_PERIODS * self._period_ms / 1000)
        if self._streaming and silent_s > longest_s:
            stalled = self._vehicle.stalls.recent
            cause = f"{stalled}." if stalled else "does another program use it?"
            consequence = ", so its battery is not monitored" if monitored else ""
            raise DeviceError(
                f"{self._vehicle.uri}: no row of the vehicle's log for {silent_s:.1f} s{consequence}: {cause}"
            )

    def _watch_battery(self, now_s: float) -> str:
        volts = self.latest.get(BATTERY)
        if self._low:
            return self._low
        if self._stop_below_v is None or volts is None or volts >= self._stop_below_v:
            self._low_since_s = None
            return ""
        if self._low_since_s is None:
            self._low_since_s = now_s
        if now_s - self._low_since_s < _LOW_FOR_S:
            return ""
        self._low = (
            f"{self._vehicle.uri}: the battery is at {volts:.2f} V, below the {self._stop_below_v:g} V of "
            "devices.crazyflie.stop_below_v in rig.toml: charge it, then resume the run."
        )
        return self._low


def _found(vehicle: Vehicle, name: str) -> Variable:
    variable = vehicle.wire.variable(name)
    if variable is None:
        raise DeviceError(f"{vehicle.uri}: this firmware does not log {name}.")
    return variable
