"""The facts above the plots as HTML: run, state, time left, battery, the vehicle, rates and losses."""

from collections.abc import Iterator, Sequence
from html import escape

from cfid.console.messages import clock
from cfid.counted import counted
from cfid.recordings.crazyflie import printable
from cfid.watch.live_run import DeviceProgress, LiveRun

_CATCHING_UP = 0.05  # fraction of the files not yet read, above which the page reports it
_LOW_V = 3.2
_SLOWEST_HZ = 2.0  # rows that come more slowly are events
_LONGEST = 300


def facts_html(run: LiveRun | None, *, refused: int, stops: Sequence[str] = ()) -> str:
    """Return a table of facts; texts from the run's files are escaped and contain no control characters.

    `stops` are the vehicles that the page's button stops.
    """
    none = "<p>No run yet. The page shows the first one as soon as it begins.</p>" if run is None else ""
    rows = [("the button stops", ", ".join(stops), False)] if stops else []
    if run is not None:
        rows += [*_of_run(run), *(_of_device(name, device, run) for name, device in run.devices.items())]
    if refused:
        rows.append(("requests refused", f"{refused} from outside this page", True))
    cells = "".join(
        f'<tr><th>{escape(name)}</th><td class="{"warning" if warning else ""}">{_text(text)}</td></tr>'
        for name, text, warning in rows
    )
    return f"{none}<table>{cells}</table>"


def _text(text: str) -> str:
    return escape(printable(text, _LONGEST))


def _of_run(run: LiveRun) -> Iterator[tuple[str, str, bool]]:
    header = run.header
    yield "run", run.folder.name + (", simulated" if header.simulated else ""), False
    if header.label.note:
        yield "note", header.label.note, False
    recording = "recording, but" if run.recording_now else "cut,"
    state = f"{recording} no row for {run.quiet_s:.0f} s" if run.silent else header.state
    yield "state", ": ".join(filter(None, [state, header.reason])), run.silent or header.state == "failed"
    if header.verdict is not None and header.state != "failed":  # a failed run's verdict is its reason, shown above
        usable = header.verdict.usable
        yield "verdict", header.verdict.text if usable else f"not usable: {header.verdict.text}", not usable
    left_s = run.left_s
    lasted = f"{clock(run.now_s)} min" + ("" if left_s is None else f", {clock(left_s)} min left")
    yield "time", lasted, False
    if run.behind > _CATCHING_UP:
        yield "reading", f"{100 * (1 - run.behind):.0f} % of the files so far", False
    if (volts := run.battery_v) is not None:
        yield "battery", f"{volts:.2f} V", volts < _LOW_V
    if (vehicle := run.vehicle_state) is not None:
        when = "vehicle" if run.recording_now and not run.silent else "vehicle, last seen"
        yield when, vehicle.name + (f": {vehicle.remedy}" if vehicle.remedy else ""), bool(vehicle.remedy)


def _of_device(name: str, device: DeviceProgress, run: LiveRun) -> tuple[str, str, bool]:
    record = run.header.devices.get(name, device.record)
    requested = f" of {record.rate_hz:g}" if record.rate_hz else ""
    rate_hz = run.rate_hz(device)
    rate = f"{rate_hz:.0f}{requested} Hz, " if rate_hz > _SLOWEST_HZ else ""
    lost = device.missing if run.recording else record.lost
    losses = "" if lost is None and run.recording else f", {'losses unknown' if lost is None else f'{lost} lost'}"
    unreadable = f", {counted(device.tail.unreadable, 'byte')} unreadable" if device.tail.unreadable else ""
    return name, f"{rate}{counted(device.rows, 'row')}{losses}{unreadable}", bool(lost or device.tail.unreadable)
