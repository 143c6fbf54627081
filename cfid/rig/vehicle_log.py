"""Records what the vehicle logs: battery, motors and its other measurements, up to a row a millisecond."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from twisted.internet.defer import CancelledError, Deferred
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument, Silence
from cfid.rig.motor_log import MotorWatch
from cfid.rig.progress import Reading
from cfid.rig.vehicle import BATTERY, LogBlock, Vehicle
from cfid.wire.crtp import LOG_DATA_CHANNEL, LOG_PORT, Variable


class CrazyflieLog(Instrument):
    """One log block of the vehicle; `t` is when a row arrived, `vehicle_ms` when the vehicle made it (it wraps)."""

    name = "crazyflie"

    def __init__(
        self,
        vehicle: Vehicle,
        names: Sequence[str],
        record: DeviceRecord,
        *,
        period_ms: int,
        stop_below_v: float | None,
        idle_thrust: int = 0,
        reading: Reading | None = None,
    ) -> None:
        """Take variables of 26 bytes at most; a battery below `stop_below_v` or disobedient motors end the run."""
        self.record, self.reading = record, reading
        self.latest: dict[str, float] = {}
        self._names, self._period_ms, self._stop_below_v = names, period_ms, stop_below_v
        self._vehicle = vehicle
        self._block = LogBlock(vehicle, names)
        self._motors = MotorWatch(vehicle, idle_thrust=idle_thrust)
        self._rows: list[tuple[float, int, tuple[float, ...]]] = []
        self._last_ms: int | None = None
        self._low_since_s: float | None = None
        self._low = ""  # the fault as reported: later rows do not change it
        self._newest_ms: int | None = None
        self._rejected = self._duplicates = 0
        self._streaming = False
        self._refusal: BaseException | None = None
        self._beginning: Deferred[None] | None = None

    def start(self, hardware: Hardware) -> None:
        """Request the rows; a refusal shows in the next block."""
        self._hardware = hardware
        self._silence = Silence(hardware, period_s=self._period_ms / 1000)
        self._vehicle.begin()
        self._vehicle.listen(LOG_PORT, LOG_DATA_CHANNEL, self._take_row)
        self._beginning = Deferred.fromCoroutine(self._begin()).addErrback(self._refused)

    def take(self) -> Block:
        """Return the rows, with a fault for a low battery or disobedient motors. Raises DeviceError for a refusal."""
        if self._refusal is not None:
            raise self._refusal
        rows, self._rows = self._rows, []
        if not rows:
            self._watch()
            return self.block()
        times_s = self._hardware.unix_times_s(np.array([arrived_s for arrived_s, _, _ in rows]))
        stamps_ms = np.array([stamp_ms for _, stamp_ms, _ in rows])
        values = zip(*(row for _, _, row in rows), strict=True)
        fault = self._motors.fault or self._watch_battery(rows[-1][0])
        columns = map(self._column, values, self._block.variables)
        return Block((times_s, stamps_ms, *columns), self._missing(stamps_ms), fault)

    async def stop(self) -> None:
        """End the stream, unless the vehicle is out of reach."""
        self._streaming = False
        if self._beginning is not None:
            self._beginning.cancel()
        await self._block.delete()

    def close(self) -> None:
        """Take no further row."""
        self._vehicle.ignore(LOG_PORT, LOG_DATA_CHANNEL, self._take_row)

    def facts(self) -> Mapping[str, Any]:
        """Return how many rows were invalid, and how many were duplicates."""
        return {"losses": {"rejected": self._rejected, "duplicates": self._duplicates}}

    async def _begin(self) -> None:
        await self._block.start(self._period_ms)
        self._streaming = True
        self._silence.end()

    def _refused(self, failure: Failure) -> None:
        if not failure.check(CancelledError):
            self._refusal = failure.value

    def _take_row(self, payload: bytes, arrived_s: float) -> None:
        row = self._block.row(payload)
        if not self._streaming:  # a row of an earlier run, whose stop was still on its way
            return
        if row is None:
            self._rejected += self._block.is_row(payload)
            return
        if row[0] == self._newest_ms:  # datagrams may arrive twice
            self._duplicates += 1
            return
        self._newest_ms = row[0]
        self._rows.append((arrived_s, *row))
        self._silence.end()
        self.latest = dict(zip(self._names, row[1], strict=True))
        self._motors.take(arrived_s, self.latest)

    def _column(self, values: Sequence[float], variable: Variable) -> Any:
        """Return a column as the vehicle sent it: a float32 with no more digits than it has."""
        if variable.kind in "fe":
            return np.array([float(str(np.float32(value))) for value in values])
        return np.array(values, dtype=np.int64)

    def _missing(self, stamps_ms: Any) -> int:
        begin_ms = stamps_ms[0] if self._last_ms is None else self._last_ms
        steps = np.rint(np.diff(stamps_ms, prepend=begin_ms) % (1 << 24) / self._period_ms)
        self._last_ms = int(stamps_ms[-1])
        return int(np.maximum(steps - 1, 0).sum())

    def _watch(self) -> None:
        """Raise DeviceError when rows, and the voltage in them, stop coming: another client may have reset the log."""
        monitored = BATTERY in self._names
        if self._streaming and self._silence.exceeds(0.5 if monitored else 3.0):
            consequence = ", so its battery is not monitored" if monitored else ""
            raise DeviceError(
                f"{self._vehicle.uri}: no row of the vehicle's log for {self._silence.seconds:.1f} s{consequence}: "
                "does another program use it?"
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
        # A start of the motors pulls the voltage down for a moment.
        if now_s - self._low_since_s < 0.5:
            return ""
        self._low = (
            f"{self._vehicle.uri}: the battery is at {volts:.2f} V, below the {self._stop_below_v:g} V of "
            "devices.crazyflie.stop_below_v in rig.toml: charge it, then resume the run."
        )
        return self._low
