"""Records one run, samples into memory, or drives motors: whatever ends it, every device is stopped and closed."""

import sys
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.records.rig_file import NONE_STATED, RigFacts
from cfid.records.run import Label, Run
from cfid.records.run_writer import RunWriter, create_run
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument, Say
from cfid.rig.keyboard import Keyboard
from cfid.rig.lock import BUTTON_SIGNALS
from cfid.rig.loop import Ending, until_over
from cfid.rig.recorder import BLOCK_S, Memory, Recorder, Sampled
from cfid.version import __version__

Procedure = Callable[[Mapping[str, Any], Hardware], Coroutine[Any, Any, None]]  # of the run's instruments by name
Notice = Callable[[str, Sequence[Any]], str]  # takes a device's new columns; returns what is wrong, "" for nothing
Show = Callable[[Recorder], None]
Stopped = Callable[[float], None]  # gets the seconds that the motors' stop took

_MOTORS = ("commands", "crossings")  # instruments that turn motors
_OPERATOR = "the operator"
_STOPPED_BY = {"SIGINT": "stopped by Ctrl-C", BUTTON_SIGNALS[0].name: "stopped by the page's button"}


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
    notice: Notice = lambda name, columns: ""
    asks: bool = False
    facts: RigFacts = NONE_STATED
    requested: Mapping[str, Any] = field(default_factory=dict)
    simulated: bool = False


def record_run(
    plan: Plan,
    instruments: Sequence[Instrument],
    hardware: Hardware,
    *,
    show: Show,
    begun: Callable[[Path], None],
    say: Say = lambda _: None,
    stopped: Stopped = lambda _: None,
) -> Run:
    """Record instruments into a new run until the plan's time is over or a signal arrives.

    `begun` gets the run's folder, `show` is called after every block, `say` gets what the plan's `notice` returned,
    and `stopped` the seconds that the motors' stop took, which run.toml states too where it can be written.
    Without a procedure, a run that a signal ended is complete, and so is one whose procedure had only its last pause
    left. Raises DeviceError or DataError with the first failure; the run is then closed as failed, or as complete in
    that pause, and all rows until then are kept. Raises KeyboardInterrupt when it was ended before the first row.
    """

    async def main(ending: Ending) -> Run:
        lasting = {} if plan.for_s is None else {"for_s": plan.for_s}
        with create_run(
            plan.runs_folder,
            kind=plan.kind,
            label=plan.label,
            devices={instrument.name: instrument.record for instrument in instruments},
            started=datetime.fromtimestamp(hardware.unix_s(), UTC),
            cfid_version=__version__,
            simulated=plan.simulated,
            facts=plan.facts,
            requested={**plan.requested, **lasting},
        ) as run:
            begun(run.folder)
            return await _recorded(plan, instruments, run, hardware, ending, show=show, say=say, stopped=stopped)

    return hardware.run(main)


def drive(
    instruments: Sequence[Instrument],
    procedure: Procedure,
    hardware: Hardware,
    *,
    show: Show,
    stopped: Stopped,
    into: Memory | None = None,
    lasts_s: float | None = None,
    tare_s: float = 0.0,
) -> None:
    """Carry out a procedure without a run; `stopped` gets the seconds that the motors' stop took, `into` the rows.

    The live line counts down `lasts_s`, and shows forces relative to those of the first `tare_s`. Raises DeviceError
    like `record_run`; in every case the motors are stopped and checked.
    """

    async def main(ending: Ending) -> None:
        recorder = Recorder(instruments, into or Memory(keep=False), hardware, show=show, for_s=lasts_s, tare_s=tare_s)
        try:
            await recorder.record(lambda: _carry_out(procedure, instruments, hardware, ending))
        finally:
            _tell_stop(instruments, stopped)

    hardware.run(main)


def sample(
    instruments: Sequence[Instrument],
    hardware: Hardware,
    *,
    for_s: float,
    show: Show,
    procedure: Procedure | None = None,
    stopped: Stopped = lambda _: None,
    tare_s: float = 0.0,
) -> dict[str, Sampled]:
    """Sample instruments for `for_s` seconds, or until a procedure as long as that ends; return each by its name.

    The live line shows forces relative to those of the first `tare_s`. Raises DeviceError as a recording does,
    KeyboardInterrupt when a signal ended it; motors are stopped and checked.
    """
    memory, complete = Memory(), False

    async def until_done(by_name: Mapping[str, Any], hardware: Hardware) -> None:
        nonlocal complete
        await (hardware.sleep(for_s) if procedure is None else procedure(by_name, hardware))
        complete = True

    drive(instruments, until_done, hardware, show=show, stopped=stopped, into=memory, lasts_s=for_s, tare_s=tare_s)
    if not complete:
        raise KeyboardInterrupt
    return {instrument.name: memory.sampled(instrument.name, instrument.record.columns) for instrument in instruments}


async def _recorded(
    plan: Plan,
    instruments: Sequence[Instrument],
    run: RunWriter,
    hardware: Hardware,
    ending: Ending,
    *,
    show: Show,
    say: Say,
    stopped: Stopped,
) -> Run:
    sampled = [instrument.name for instrument in instruments if not instrument.eventful]

    def begin() -> Deferred[None]:
        if plan.procedure is None:
            return ending.within(plan.for_s)
        return _carry_out(plan.procedure, instruments, hardware, ending)

    with closing(_Notices(plan, hardware, ending, say)) as notices:
        recorder = Recorder(
            instruments,
            run,
            hardware,
            show=show,
            notice=notices.examine,
            for_s=plan.lasts_s if plan.for_s is None else plan.for_s,
            tare_s=plan.tare_s,
        )
        try:
            await recorder.record(begin)
        except DeviceError as error:
            if _is_whole(instruments) and all(run.rows(name) for name in sampled):
                run.close("complete", reason=str(error))
            raise
        finally:
            _tell_stop(instruments, stopped)
    empty = [name for name in sampled if not run.rows(name)]
    if ending.signal and empty and len(empty) == len(sampled):
        raise KeyboardInterrupt
    if empty:
        raise DeviceError(
            f"{empty[0]}: not one sample in {recorder.seconds:.1f} s. `cfid rig check` looks for the cause."
        )
    by = _STOPPED_BY.get(ending.signal, f"ended by {ending.signal}")
    early = f"{by} after {recorder.seconds:.1f} s" if ending.signal else ""
    if plan.procedure is None:
        return run.close("complete", reason=early if plan.for_s else "")
    whole = _is_whole(instruments)
    return run.close("interrupted" if early and not whole else "complete", reason="" if whole else early)


def _is_whole(instruments: Iterable[Instrument]) -> bool:
    """Return whether a procedure did all that was requested, so that only its last pause was left."""
    return any(instrument.whole for instrument in instruments)


def _tell_stop(instruments: Iterable[Instrument], stopped: Stopped) -> None:
    for instrument in instruments:
        seconds = instrument.facts().get("stopped_in_s") if instrument.name in _MOTORS else None
        if seconds is not None:
            stopped(seconds)


def _carry_out(
    procedure: Procedure, instruments: Sequence[Instrument], hardware: Hardware, ending: Ending
) -> Deferred[None]:
    """Return a Deferred that fires when a procedure is over; before motors start, every device has to have begun."""
    by_name = {instrument.name: instrument for instrument in instruments}

    async def carried_out() -> None:
        if any(name in by_name for name in _MOTORS):
            while not all(instrument.begun for instrument in instruments):
                await hardware.sleep(BLOCK_S)
        await procedure(by_name, hardware)

    return until_over(ending, Deferred.fromCoroutine(carried_out()))


class _Notices:
    """Asks the operator about each thing that a plan's `notice` finds in the rows.

    At a terminal n ends the recording, y or no key goes on; a script gets the sentence alone. Where a procedure asks
    for readings, the keyboard belongs to that, and the operator too gets the sentence alone.
    """

    def __init__(self, plan: Plan, hardware: Hardware, ending: Ending, say: Say) -> None:
        self._notice, self._hardware, self._ending, self._say = plan.notice, hardware, ending, say
        self._asks = not plan.asks and sys.stdin is not None and sys.stdin.isatty()
        self._keyboard: Keyboard | None = None

    def examine(self, name: str, columns: Sequence[Any]) -> None:
        wrong = self._notice(name, columns)
        if not wrong:
            return
        if not self._asks:
            self._say(wrong)
            return
        if self._keyboard is None:
            self._keyboard = Keyboard(self._typed, hardware=self._hardware, keys=True)
            self._keyboard.open()
        self._say(f"{wrong} The recording goes on; n ends it, y goes on without this question.")

    def close(self) -> None:
        keyboard, self._keyboard = self._keyboard, None
        if keyboard is not None:
            keyboard.close()

    def _typed(self, key: str | None) -> None:
        if key in ("n", "N"):
            self._ending.request(_OPERATOR)
        if key in ("n", "N", "y", "Y", "\n", "\r", None):
            self.close()
