"""Records one run: opens its devices, records until the end, and closes them however it ends."""

from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.records.rig_file import NONE_STATED, RigFacts
from cfid.records.run import Label, Run
from cfid.records.run_writer import RunWriter, create_run
from cfid.rig.clock import HostClock
from cfid.rig.device import Device
from cfid.rig.hand_held import Readings
from cfid.rig.lines import Lines
from cfid.rig.loop import Ending, Loop, run_until_done, until_over
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.noticing import Notice, Noticing
from cfid.rig.recorder import BLOCK_S, Instrument, Recorder, Say, Sink, sleep
from cfid.version import __version__

Procedure = Callable[[Mapping[str, Any], Loop], Coroutine[Any, Any, None]]  # of the run's instruments by name


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to record, where to and for how long; None means until the operator ends it.

    With a `procedure` the run lasts as long as the procedure takes, and counts as interrupted when it ends earlier; the
    live line counts down `lasts_s`, and shows forces relative to those of the first `tare_s`.
    `notice` examines the rows as they arrive, and what it returns is shown to the operator; a procedure that `asks`
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
    and `stopped` the seconds that the motors' stop took, which run.toml states too where it can be written.
    Without a procedure, a run that a signal ended is complete, and so is one whose procedure had only its last pause
    left. Raises DeviceError or DataError with the first failure; the run is then closed as failed, or as complete in
    that pause, and all rows until then are kept. Raises KeyboardInterrupt when it was ended before the first row.
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

    The live line counts down `lasts_s`, and shows forces relative to those of the first `tare_s`. Raises DeviceError
    like `record_run`; in every case the motors are stopped and checked.
    """

    async def main(loop: Loop, ending: Ending) -> None:
        clock = HostClock.now()
        instruments = [device.open(loop, clock) for device in devices]
        recorder = Recorder(instruments, into, loop=loop, show=lambda: show(recorder))
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
        sampled = [
            instrument.name for instrument, device in zip(instruments, devices, strict=True) if not device.eventful
        ]
        try:
            await recorder.record(lambda: _lasting(plan, instruments, loop, ending))
        except DeviceError as error:
            if _is_whole(instruments) and all(run.rows(name) for name in sampled):
                run.close("complete", reason=str(error))
            raise
        finally:
            _tell_stop(instruments, stopped)
        if ending.signal and not any(run.rows(name) for name in sampled):
            raise KeyboardInterrupt
        _check_rows(run, sampled, recorder.seconds)
        early = f"ended by {ending.signal} after {recorder.seconds:.1f} s" if ending.signal else ""
        return _closed(run, plan, early, whole=_is_whole(instruments))


def _check_rows(run: RunWriter, sampled: Iterable[str], seconds: float) -> None:
    """Raise DeviceError for a device that sent nothing."""
    for name in sampled:
        if not run.rows(name):
            raise DeviceError(f"{name}: not one sample in {seconds:.1f} s. `cfid rig check` looks for the cause.")


def _closed(run: RunWriter, plan: Plan, early: str, *, whole: bool) -> Run:
    """Close a run as complete, or as interrupted where its procedure was ended before it had done everything."""
    if plan.procedure is None:
        return run.close("complete", reason=early if plan.for_s else "")
    return run.close("interrupted" if early and not whole else "complete", reason="" if whole else early)


def _is_whole(instruments: Iterable[Instrument]) -> bool:
    """Return whether a procedure did all that was requested, so that only its last pause was left."""
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

    async def carried_out() -> None:
        if "commands" in by_name or "crossings" in by_name:
            await _lines_begun(instruments, loop)
        await procedure(by_name, loop)

    return until_over(ending, Deferred.fromCoroutine(carried_out()))


async def _lines_begun(instruments: Iterable[Instrument], loop: Loop) -> None:
    """Before motors start, wait for a line from each device that sends lines; a silent one ends the recording."""
    while not all(one.begun for one in instruments if isinstance(one, Lines)):
        await sleep(loop, BLOCK_S)
