"""Plays a sine on board, and records its crossings of the middle as they are reported, and its end."""

from collections.abc import Mapping
from typing import Any

from twisted.internet.defer import Deferred

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord
from cfid.rig.app_motors import AppMotors
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument
from cfid.rig.motors import STOPPED, Firmware
from cfid.rig.vehicle import Vehicle
from cfid.wire import app
from cfid.wire.app import AppOutcome, Done, SineChannel, SineRequest

_DONE_AFTER_S = 1.0  # from the motors' stop to the byte that reports the end (C.2.4)
_NUMBERS = 1 << 16  # of reports, after which they start anew
_OUTCOMES: Mapping[int | None, str] = {
    AppOutcome.FINISHED: "played to its end",
    AppOutcome.STOPPED: "was stopped",
    AppOutcome.KEEP_ALIVE_LOST: "was stopped by the vehicle, which received no keep-alive",
    AppOutcome.MOTORS_NOT_ALLOWED: "was stopped by the vehicle's supervisor: not armed, tumbled or stopped",
}


class Crossings(Instrument):
    """The reports of one sine: `t` is when they arrived, beside the sample's index and the time on board."""

    name = "crossings"
    columns = ("t", "thrust_rec", "sample", "vehicle_us", "report")

    eventful = True

    def __init__(self, player: AppMotors, vehicle: Vehicle, firmware: Firmware, record: DeviceRecord) -> None:
        """Take the app's motors, which can play."""
        self.record = record
        self._player, self._vehicle, self._port = player, vehicle, firmware.ports.sine
        self._reports: list[tuple[float, ...]] = []
        self._next_report = self._missing = self._duplicates = 0
        self._rejected = self._samples = 0
        self._done: Deferred[Done] | None = None
        self._end: Done | None = None
        self._running = self._started = self._ended = False
        self._stopped_in_s: float | None = None

    def start(self, hardware: Hardware) -> None:
        """Begin to monitor the motors."""
        self._hardware = hardware
        self._running = True
        self._vehicle.listen(self._port, SineChannel.CROSSING, self._take_crossing)
        self._vehicle.listen(self._port, SineChannel.DONE, self._take_done)
        self._player.start()

    async def play(self, request: SineRequest) -> Done:
        """Play a sine to its end. Raises DeviceError when it does not begin, does not end, or is cut short."""
        if not self._running:
            raise DeviceError(STOPPED)
        await self._player.be_ready(request)
        lasts_s = request.samples / app.SAMPLES_PER_S
        self._started, self._done, self._samples = True, Deferred(), request.samples
        await self._player.play(request)
        longest_s = lasts_s + _DONE_AFTER_S
        silent = self._hardware.later(1.0, self._check_begun)
        # The link may be slow, and so may the clock of a vehicle.
        late = self._hardware.later(1.1 * longest_s + 2.0, self._complain, "no report of its end arrived")
        try:
            done = await self._done
        finally:
            self._done = None
            for timer in (silent, late):
                if timer.active():
                    timer.cancel()
        if done.outcome not in (None, AppOutcome.FINISHED):
            raise DeviceError(
                f"{self._vehicle.uri}: the sine {_outcome(done)}, after {counted(done.samples or 0, 'sample')}."
            )
        await self._player.refuse_driven()  # any command up to the crest is one that a sine may have
        return done

    def take(self) -> Block:
        """Return the reports. Raises DeviceError when the vehicle is out of reach."""
        if self._running:
            self._player.check()
        reports, self._reports = self._reports, []
        missing, self._missing = self._missing, 0
        return self.block(reports, missing)

    async def stop(self) -> None:
        """Stop the motors. Raises DeviceError when it is not certain that they stopped."""
        if self._running:
            self._running = False
            self._stopped_in_s = await self._player.stop()

    def close(self) -> None:
        """Take no further report."""
        self._vehicle.ignore(self._port, SineChannel.CROSSING, self._take_crossing)
        self._vehicle.ignore(self._port, SineChannel.DONE, self._take_done)

    def facts(self) -> Mapping[str, Any]:
        """Return what the vehicle reported at the end, invalid and repeated reports, and how long the stop took."""
        end = self._end._asdict() if self._end is not None else {}
        stopped = {} if self._stopped_in_s is None else {"stopped_in_s": round(self._stopped_in_s, 4)}
        known = {key: value for key, value in end.items() if value is not None}
        return {"end": known, "rejected": self._rejected, "duplicates": self._duplicates, **stopped}

    def _check_begun(self) -> None:
        if not (self._next_report or self._player.playing):
            self._complain("no report of a first sample arrived")

    def _complain(self, what: str) -> None:
        if self._done is not None and not self._done.called:
            self._done.errback(DeviceError(f"{self._vehicle.uri}: the sine did not run: {what}."))

    def _take_crossing(self, payload: bytes, arrived_s: float) -> None:
        if not self._started:  # of an earlier sine
            return
        crossing = app.decode_crossing(payload)
        if crossing is None:
            self._rejected += 1
            return
        missing = (crossing.number - self._next_report) % _NUMBERS
        if missing >= _NUMBERS // 2:  # an earlier number: a datagram may arrive twice
            self._duplicates += 1
            return
        self._missing, self._next_report = self._missing + missing, crossing.number + 1
        self._reports.append((arrived_s, *crossing))
        if crossing.sample != self._samples:
            return
        self._ended = True
        if self._done is not None:  # the motors are off; the byte `a` may be lost
            self._hardware.later(_DONE_AFTER_S + 0.5, self._finish, self._done, Done(None, crossing.sample))

    def _take_done(self, payload: bytes, arrived_s: float) -> None:
        if not self._started:  # of an earlier sine
            return
        done = app.decode_done(payload)
        if done is None:
            self._rejected += 1
        elif self._done is not None:
            self._finish(self._done, done)

    def _finish(self, waiting: Deferred[Done], done: Done) -> None:
        if waiting is self._done and not waiting.called:
            self._end = done
            self._missing += not self._ended and done.outcome == AppOutcome.FINISHED  # its last report was lost
            waiting.callback(done)


def _outcome(done: Done) -> str:
    return _OUTCOMES.get(done.outcome, f"ended with {done.outcome}")
