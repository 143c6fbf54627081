"""Records one run: locks and opens devices, records until the end, and closes them however it ends."""

from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from twisted.internet.defer import Deferred

from cfid import __version__
from cfid.errors import ConfigError, DeviceError
from cfid.records.devices import EncoderPort, LoadCellBox
from cfid.records.facts import NONE_STATED, RigFacts
from cfid.records.line_devices import EncoderLines, LoadCellLines
from cfid.records.run import DeviceRecord, Label, Run
from cfid.records.run_writer import create_run
from cfid.rig import box as loadcell_box
from cfid.rig.clock import HostClock
from cfid.rig.e201_port import find_encoder, lock_name
from cfid.rig.encoder import Encoder
from cfid.rig.hand_held import Readings
from cfid.rig.loadcell import LoadCell
from cfid.rig.lock import DeviceLock
from cfid.rig.loop import Ending, Loop, run_until_done, until_over
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.noticing import Notice, Noticing
from cfid.rig.progress import Reading
from cfid.rig.rdt_port import Inbox, RdtPort
from cfid.rig.ready_lines import angle_scale, ready_lines
from cfid.rig.recorder import Instrument, Nowhere, Recorder, Say, Sink
from cfid.rig.serial_line import serial_lines
from cfid.rig.shown import degrees, first_force, vertical_force

Open = Callable[[Loop, HostClock], Instrument]
Procedure = Callable[[Mapping[str, Any], Loop], Coroutine[Any, Any, None]]  # of the run's instruments by name


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device that was checked and locked: its description in run.toml, and how a loop opens it.

    An `eventful` device may have no rows; any other device without rows is a fault. `reading` is what the live line
    shows of it.
    """

    record: DeviceRecord
    open: Open
    eventful: bool = False
    reading: Reading | None = None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to record, where to and for how long; None means until the operator ends it.

    With a `procedure` the run lasts as long as that takes, and counts as interrupted when it ends before; the live
    line counts `lasts_s` down, and shows forces above those of the first `tare_s`.
    `notice` looks at the rows as they arrive, and what it returns is put before the operator; a procedure that `asks`
    for readings keeps the keyboard. The rig's `facts` and what was `requested` go into run.toml unchanged.
    """

    runs_folder: Path
    kind: str
    label: Label
    for_s: float | None = None
    procedure: Procedure | None = None
    lasts_s: float | None = None
    tare_s: float = 0.0
    notice: Notice | None = None
    asks: bool = False
    facts: RigFacts = NONE_STATED
    requested: Mapping[str, Any] = field(default_factory=dict)
    simulated: bool = False


def ready_encoder(
    setting: EncoderPort | EncoderLines, held: ExitStack, *, counts_per_turn: float | str, continuous: bool, say: Say
) -> Device:
    """Find and lock the encoder; return how it is recorded. Raises ConfigError or DeviceError."""
    if isinstance(setting, EncoderLines):
        scale = angle_scale(setting, counts_per_turn)
        record, opened_lines = ready_lines("encoder", setting, held, say=say, scale=scale)
        return Device(record=record, open=opened_lines, reading=degrees(setting.turn(counts_per_turn)))
    found = find_encoder(setting.port, counts_per_turn=counts_per_turn)
    names = [lock_name(found.port)]
    holding = held.enter_context(ExitStack())
    holding.enter_context(DeviceLock.take(names[0]))

    def again() -> Any:
        """Find it after its plug was pulled; where it then has another port, lock that one instead."""
        there = find_encoder(setting.port, counts_per_turn=counts_per_turn, serial_number=found.serial_number)
        name = lock_name(there.port)
        if name != names[-1]:
            lock = DeviceLock.take(name)
            holding.close()
            holding.enter_context(lock)
            names.append(name)
        return there

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        return Encoder(
            found,
            open_line=serial_lines(loop),
            find=again,
            counts_per_turn=counts_per_turn,
            rate_hz=setting.rate_hz,
            continuous=continuous,
            loop=loop,
            clock=clock,
            say=say,
        )

    record = DeviceRecord.model_validate(
        {
            "file": "encoder.csv",
            "columns": ("t", "phi", "device_us") if found.stamped and not continuous else ("t", "phi"),
            "counts_per_turn": counts_per_turn,
            "asked": "continuous" if continuous else "polled",
            "rate_hz": setting.rate_hz,
            "interface": found._asdict(),
        }
    )
    return Device(record=record, open=opened, reading=degrees(counts_per_turn))


def ready_loadcell(
    setting: LoadCellBox | LoadCellLines,
    held: ExitStack,
    *,
    buffered: bool,
    bias: bool,
    say: Say,
    patient: bool = True,
) -> Device:
    """Lock the load cell, set its rate and read its settings; return how it is recorded.

    Without `patient` the run ends as soon as its stream breaks off. Raises ConfigError or DeviceError.
    """
    if isinstance(setting, LoadCellLines):
        if bias:
            raise ConfigError("`bias`: only a Net F/T box has a bias; fits take the zero from pauses.")
        record, opened_lines = ready_lines("loadcell", setting, held, say=say, patient=patient, scale={"units": "n,nm"})
        return Device(record=record, open=opened_lines, reading=first_force(setting.measured[0].name))
    setting = loadcell_box.resolved(setting)
    where = f"{setting.address}:{setting.rdt_port}"
    held.enter_context(DeviceLock.take(where))
    if bias and not loadcell_box.take_bias(setting):
        say(f"{where}: the box' page still shows the earlier bias. Check that the load reads zero now.")
    settings = loadcell_box.set_rate(setting, buffered=buffered)

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        inbox = Inbox((setting.address, setting.rdt_port))
        port = RdtPort(inbox, box=(setting.address, setting.rdt_port), reactor=loop)
        port.startListening()
        return LoadCell(
            settings,
            inbox,
            port,
            where=where,
            loop=loop,
            clock=clock,
            say=say,
            buffered=buffered,
            patient=patient,
        )

    record = DeviceRecord.model_validate(
        {
            "file": "loadcell.csv",
            "columns": LoadCell.columns,
            "counts_per_n": settings.counts_per_n,
            "counts_per_nm": settings.counts_per_nm,
            "asked": "buffered" if buffered else "real-time",
            "rate_hz": settings.rate_hz,
            "biased": bias,
            "address": where,
            "settings": settings._asdict(),
        }
    )
    return Device(record=record, open=opened, reading=vertical_force(settings.counts_per_n))


def record_run(
    plan: Plan,
    devices: Sequence[Device],
    *,
    show: Callable[[Recorder], None],
    begun: Callable[[Path], None],
    say: Say = lambda _: None,
    stopped: Callable[[float], None] = lambda _: None,
) -> Run:
    """Record the devices into a new run until the plan's time is over or a signal arrives.

    `begun` gets the run's folder, `show` is called after every block, `say` gets what the plan's `notice` returned,
    `stopped` the seconds that the motors' stop took, which run.toml has too where it can be written.
    Without a procedure, a run that a signal ended is complete, and so is one whose procedure had only its last pause
    left. Raises DeviceError or DataError with the first failure, with the run closed as failed, or as complete in that
    pause, and all rows until then kept; KeyboardInterrupt when it was ended before the first row.
    """

    async def main(loop: Loop, ending: Ending) -> Run:
        return await _recorded(plan, devices, loop, ending, show=show, begun=begun, say=say, stopped=stopped)

    return run_until_done(main)


def drive(
    devices: Sequence[Device],
    procedure: Procedure,
    *,
    show: Callable[[Recorder], None],
    stopped: Callable[[float], None],
    into: Sink | None = None,
    lasts_s: float | None = None,
    tare_s: float = 0.0,
) -> None:
    """Carry out a procedure without a run; `stopped` gets the seconds that the motors' stop took, `into` the rows.

    The live line counts `lasts_s` down, and shows forces above those of the first `tare_s`. Raises DeviceError like
    `record_run`; in every case the motors are stopped and checked.
    """

    async def main(loop: Loop, ending: Ending) -> None:
        clock = HostClock.now()
        instruments = [device.open(loop, clock) for device in devices]
        recorder = Recorder(instruments, into or Nowhere(), loop=loop, show=lambda: show(recorder))
        recorder.for_s, recorder.tare_s = lasts_s, tare_s
        _add_readings(recorder, instruments, devices)
        try:
            await recorder.record(lambda: _first_of(ending, procedure, instruments, loop))
        finally:
            _tell_stop(instruments, stopped)

    run_until_done(main)


async def _recorded(
    plan: Plan,
    devices: Sequence[Device],
    loop: Loop,
    ending: Ending,
    *,
    show: Callable[[Recorder], None],
    begun: Callable[[Path], None],
    say: Say,
    stopped: Callable[[float], None],
) -> Run:
    clock = HostClock.now()
    instruments = [device.open(loop, clock) for device in devices]
    lasting = {} if plan.for_s is None else {"for_s": plan.for_s}
    with (
        ExitStack() as closing,
        create_run(
            plan.runs_folder,
            kind=plan.kind,
            label=plan.label,
            devices={instrument.name: device.record for instrument, device in zip(instruments, devices, strict=True)},
            started=datetime.now(UTC),
            cfid_version=__version__,
            simulated=plan.simulated,
            facts=plan.facts,
            requested={**plan.requested, **lasting},
        ) as run,
    ):
        begun(run.folder)
        sink: Sink = run
        if plan.notice is not None:
            sink = noticing = Noticing(run, plan.notice, ending=ending, loop=loop, say=say, asks=not plan.asks)
            closing.callback(noticing.close)
        recorder = Recorder(instruments, sink, loop=loop, show=lambda: show(recorder))
        recorder.for_s = plan.lasts_s if plan.for_s is None else plan.for_s
        recorder.tare_s = plan.tare_s
        _add_readings(recorder, instruments, devices)
        sampled = [instrument for instrument, device in zip(instruments, devices, strict=True) if not device.eventful]
        try:
            await recorder.record(lambda: _lasting(plan, instruments, loop, ending))
        except DeviceError as error:
            if _is_whole(instruments) and all(run.rows(instrument.name) for instrument in sampled):
                run.close("complete", reason=str(error))
            raise
        finally:
            _tell_stop(instruments, stopped)
        if ending.signal and not any(run.rows(instrument.name) for instrument in sampled):
            raise KeyboardInterrupt
        for instrument in sampled:
            if not run.rows(instrument.name):
                raise DeviceError(
                    f"{instrument.name}: not one sample in {recorder.seconds:.1f} s. `cfid rig check` looks for the "
                    "cause."
                )
        early = f"ended by {ending.signal} after {recorder.seconds:.1f} s" if ending.signal else ""
        if plan.procedure is not None:
            whole = _is_whole(instruments)
            return run.close("interrupted" if early and not whole else "complete", reason="" if whole else early)
        return run.close("complete", reason=early if plan.for_s else "")


def _is_whole(instruments: Iterable[Instrument]) -> bool:
    """Return whether a procedure did all that was asked for, and only its last pause was left."""
    return any(isinstance(one, MotorCommands | Readings) and one.whole for one in instruments)


def _tell_stop(instruments: Iterable[Instrument], stopped: Callable[[float], None]) -> None:
    for seconds in (instrument.facts().get("stopped_in_s") for instrument in instruments):
        if seconds is not None:
            stopped(seconds)


def _add_readings(recorder: Recorder, instruments: Sequence[Instrument], devices: Sequence[Device]) -> None:
    for instrument, device in zip(instruments, devices, strict=True):
        recorder.progress[instrument.name].reading = device.reading


def _lasting(plan: Plan, instruments: Sequence[Instrument], loop: Loop, ending: Ending) -> Deferred[None]:
    """Return a Deferred that fires when the run is over."""
    if plan.procedure is None:
        return ending.within(plan.for_s)
    return _first_of(ending, plan.procedure, instruments, loop)


def _first_of(ending: Ending, procedure: Procedure, instruments: Sequence[Instrument], loop: Loop) -> Deferred[None]:
    by_name = {instrument.name: instrument for instrument in instruments}
    return until_over(ending, Deferred.fromCoroutine(procedure(by_name, loop)))
