"""`cfid fit rotor`: how fast rotors turn, heard in the load cell's vibration."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.options import CutOptions, Delivery, LoadCellOptions, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.errors import CfidError, DataError
from cfid.findings import rejection, warning
from cfid.motors.vibration.data import Ear, RotorOptions, told_speeds
from cfid.records.result import Result

if TYPE_CHECKING:
    from cfid.motors.vibration.estimation import RotorSpeed
    from cfid.records.parameters import Parameter, Source
    from cfid.records.run import Run
    from cfid.records.tables.wrench import WrenchRecord

_NO_WINDOW = "no window tells a rotor's speed."
_BELIEVED = 0.02  # of the tachometer's speed, from where vibration contradicts it


@dataclass(frozen=True, kw_only=True)
class Heard:
    """What was heard in one window."""

    command: int | None
    begin_s: float
    end_s: float
    speed: "RotorSpeed"
    tachometer_rad_s: float | None = None


@flat
def rotor(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run of the load cell, or its file.")],
    options: RotorOptions,
    cut: CutOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Find rotor speeds in the load cell's vibration, in each steady window or between --from and --to.

    Example: [bold]cfid fit rotor 2026-11-21_083012_thrust[/bold]
    """
    from cfid.records.tables.times import run_at
    from cfid.records.tables.wrench import read_wrench

    _ = options.expected_rad_s  # what is no range is told before any file is read
    workplace = open_workplace(rig)
    path = find_recording(run, workplace)
    record = read_wrench(path, scale.reading(reading))
    folder = run_at(path)
    try:
        heard, sources = _heard(record, folder, options, cut)
    except CfidError as error:
        raise type(error)(f"{path}: {error}") from None
    _tell(record, heard, sources, workplace, delivery)


def _heard(
    record: "WrenchRecord", run: "Run | None", options: RotorOptions, cut: CutOptions
) -> "tuple[list[Heard], tuple[Source, ...]]":
    """Listen to each window: the one by hand, else the steady ones of each command."""
    import numpy as np

    from cfid.estimate.staircase import reduce_staircase
    from cfid.records.tables.vehicle import COMMANDS, begin_s, holds, read_commands
    from cfid.records.tables.wrench import LOADCELL

    if cut.from_s is not None or cut.to_s is not None:
        window = (cut.from_s or 0.0, float(record.time_s[-1]) if cut.to_s is None else cut.to_s)
        if window[0] >= window[1]:
            raise DataError(f"the window from {window[0]:g} to {window[1]:g} s holds nothing.")
        heard = Ear(record, options).hear(*window, rotors=1)
        return [Heard(command=None, begin_s=window[0], end_s=window[1], speed=heard)], ()
    logged: dict[str, Any] = {}
    sources: tuple[Source, ...] = ()
    began_s = 0.0
    if run is not None and holds(run, COMMANDS):
        rows, commands = read_commands(run)
        began_s = begin_s(run.device_file(LOADCELL))
        logged = {"command_time_s": rows.time_s - began_s, "commands": commands}
        sources = (rows.source,)
    channels = np.column_stack([record.force_n, record.torque_nm])
    points = reduce_staircase(time_s=record.time_s, channels=channels, status=record.status, **logged).steady()
    told = None if run is None else told_speeds(run, points, began_s)
    return [
        Heard(
            command=point.command,
            begin_s=point.begin_s,
            end_s=point.end_s,
            speed=speed,
            tachometer_rad_s=None if told is None or np.isnan(told[place]) else float(told[place]),
        )
        for place, (point, speed) in enumerate(zip(points, Ear(record, options).hear_steps(points), strict=True))
    ], sources


def _tell(
    record: "WrenchRecord",
    heard: "list[Heard]",
    sources: "tuple[Source, ...]",
    workplace: Workplace,
    delivery: Delivery,
) -> None:
    def drawings() -> dict[str, Any]:
        import numpy as np

        from cfid.motors.maps.figures import rotor_spectrum_figure
        from cfid.motors.vibration.lines import spectrum

        last = heard[-1]
        first, end = np.searchsorted(record.time_s, (last.begin_s, last.end_s))
        interval_s = float(np.median(np.diff(record.time_s[first:end])))
        seen = spectrum(signal=record.force_n[first:end], interval_s=interval_s)
        turns_hz = last.speed.speed_rad_per_s / (2 * np.pi)
        title = record.name if last.command is None else f"{record.name}, command {last.command}"
        lines = [(f"{k}x", k * turns_hz) for k in (1, 2, 4)]
        return {
            f"fit_rotor_{record.name}": rotor_spectrum_figure(
                seen.frequency_hz, seen.amplitude[:, 2], lines=lines, title=title
            )
        }

    doubted = [one for one in heard if not one.speed.believed]
    deliver(
        Result(
            command="fit rotor",
            method="default",
            quantities=_parameters(heard),
            quality={"windows": len(heard), "not_believed": len(doubted)},
            findings=(
                *(warning("recording", text) for text in record.notes),
                *(
                    warning("rotor-warning", text)
                    for text in dict.fromkeys(text for one in heard for text in one.speed.warnings)
                ),
                *(warning("rotor-window-rejected", f"{_where(one)}: {' '.join(one.speed.doubts)}") for one in doubted),
                *(warning("rotor-contradicts", _contradiction(one)) for one in heard if _contradiction(one)),
                *([rejection("rotor-not-found", _NO_WINDOW, "rotor.*")] if len(doubted) == len(heard) else []),
            ),
            sources=(record.source, *sources),
            lines=tuple(_line(one) for one in heard),
            drawings=drawings,
            folder=workplace.figures_beside([record.path]),
        ),
        delivery,
        workplace.campaign,
    )


def _parameters(heard: "list[Heard]") -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

    rows = [
        {
            "cmd": one.command,
            "speed_rad_s": one.speed.speed_rad_per_s,
            "std_rad_s": one.speed.std_rad_per_s,
            "tachometer_rad_s": one.tachometer_rad_s,
            "rotors": len(one.speed.rotors),
            "from_s": one.begin_s,
            "to_s": one.end_s,
            "believed": one.speed.believed,
        }
        for one in heard
    ]
    if len(heard) == 1:
        only = heard[0].speed
        speed = Parameter(value=only.speed_rad_per_s, std=only.std_rad_per_s, unit="rad/s")
    else:
        speed = Parameter(
            value=[one.speed.speed_rad_per_s for one in heard],
            std=[one.speed.std_rad_per_s for one in heard],
            unit="rad/s",
        )
    return {"rotor.speed_rad_s": speed, "rotor.windows": Parameter(value=rows, unit="as named")}


def _where(one: Heard) -> str:
    return f"{one.begin_s:.2f} to {one.end_s:.2f} s" if one.command is None else f"command {one.command}"


def _line(one: Heard) -> str:
    speed = one.speed
    told = f"{_where(one)}: {speed.speed_rad_per_s:.2f} +- {speed.std_rad_per_s:.2g} rad/s"
    apart = "" if speed.resolved else ", rotors not told apart"
    beside = "" if one.tachometer_rad_s is None else f", tachometer {one.tachometer_rad_s:.1f} rad/s"
    return told + apart + beside


def _contradiction(one: Heard) -> str:
    if one.tachometer_rad_s is None or not one.speed.believed:
        return ""
    off = one.speed.speed_rad_per_s / one.tachometer_rad_s - 1 if one.tachometer_rad_s else 0.0
    return "" if abs(off) < _BELIEVED else f"{_where(one)}: vibration and tachometer differ by {100 * off:+.1f} %."
