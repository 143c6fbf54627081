"""The page around the plots: facts and a stop, and no inline script, so that its policy can forbid all of them."""

import time
from collections.abc import Iterator, Sequence
from html import escape

from cfid.console.messages import clock
from cfid.counted import counted
from cfid.recordings.crazyflie import printable
from cfid.records.progress import Counts
from cfid.watch.live_run import DeviceRows, LiveRun

_LOW_V = 3.2
_LONGEST = 300

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>cfid watch</title>
<style>
:root { color-scheme: light dark; --page: #fbfbf9; --text: #1f2328; }
@media (prefers-color-scheme: dark) { :root { --page: #14171b; --text: #d8dce1; } }
body { margin: 0; background: var(--page); color: var(--text); font: 14px system-ui, sans-serif; }
header { position: sticky; top: 0; z-index: 9; display: flex; flex-wrap: wrap; gap: 8px 16px; align-items: center;
  padding: 8px 12px; background: var(--page); border-bottom: 1px solid currentColor; }
h1 { font-size: 16px; margin: 0; }
#stop { font: 700 16px system-ui, sans-serif; padding: 10px 22px; border: 0; border-radius: 6px;
  background: #b3161b; color: #fff; cursor: pointer; }
#answered { white-space: pre-wrap; overflow-wrap: anywhere; }
main { padding: 8px 12px; }
table { border-collapse: collapse; font-size: 13px; width: 100%; margin-bottom: 6px; }
th { text-align: left; font-weight: 600; padding: 1px 12px 1px 0; vertical-align: top; white-space: nowrap; }
td { padding: 1px 0; width: 100%; overflow-wrap: anywhere; }
.warning { font-weight: 700; text-decoration: underline; }
</style>
</head>
<body>
<header><h1>cfid watch</h1><button id="stop" data-token="TOKEN">Stop all motors</button>
<span id="answered" role="status"></span></header>
<main><div id="facts"></div><div id="plots"></div></main>
<script src="/page.js"></script>
</body>
</html>
"""

SCRIPT = """"use strict";
const dark = matchMedia("(prefers-color-scheme: dark)");
const plots = document.createElement("script");
plots.id = "plots-script";
plots.src = "/plots/autoload.js?bokeh-autoload-element=plots-script&bokeh-app-path=/plots&dark=" + Number(dark.matches);
document.getElementById("plots").append(plots);
dark.addEventListener("change", () => location.reload());

const facts = document.getElementById("facts");
const look = async () => {
  try {
    const text = await (await fetch("/facts")).text();
    if (facts.innerHTML !== text) facts.innerHTML = text;
  } catch {
    facts.textContent = "cfid watch has ended: start it again and reload this page.";
  }
  setTimeout(look, 500);
};
look();

const answered = document.getElementById("answered");
const stop = document.getElementById("stop");
stop.addEventListener("click", async () => {
  answered.textContent = "stopping ...";
  try {
    const answer = await fetch("/stop", { method: "POST", headers: { "X-Cfid-Token": stop.dataset.token } });
    answered.textContent = answer.ok ? (await answer.json()).text
      : "NOT STOPPED: this page is of an earlier cfid watch. Reload it, or pull the battery.";
  } catch {
    answered.textContent = "NOT STOPPED: cfid watch has ended. Run cfid motors stop, or pull the battery.";
  }
});
"""

# Nothing is loaded from elsewhere, no text becomes a script, and no other page shows this one in a frame.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def page_html(token: str) -> str:
    """Return the page, with a button that stops motors."""
    return _PAGE.replace("TOKEN", escape(token))


def facts_html(run: LiveRun | None, *, refused: int, stops: Sequence[str] = ()) -> str:
    """Return a table of facts; texts from the run's files are escaped and contain no control characters.

    `stops` are the vehicles that the page's button stops.
    """
    none = "<p>No run yet. The page shows the first one as soon as it begins.</p>" if run is None else ""
    rows = [("the button stops", ", ".join(stops), False)] if stops else []
    if run is not None:
        progress, live = run.progress(), run.recording_now and not run.silent
        rows += _of_run(run, progress.left_s, live)
        rows += [(name, *_of_device(device, progress.devices.get(name), live)) for name, device in run.devices.items()]
    if refused:
        rows.append(("requests refused", f"{refused} from outside this page", True))
    cells = "".join(
        f'<tr><th>{escape(name)}</th><td class="{"warning" if warns else ""}">'
        f"{escape(printable(text, _LONGEST))}</td></tr>"
        for name, text, warns in rows
    )
    return f"{none}<table>{cells}</table>"


def _of_run(run: LiveRun, left_s: float | None, live: bool) -> Iterator[tuple[str, str, bool]]:
    """Yield the names of facts, their texts, and whether they are warnings; `live` means that rows arrive now."""
    header = run.header
    yield "run", run.folder.name + (", simulated" if header.simulated else ""), False
    if header.label.note:
        yield "note", header.label.note, False
    recording = "recording, but" if run.recording_now else "cut,"
    state = f"{recording} no progress for {run.quiet_s:.0f} s" if run.silent else header.state
    yield "state", ": ".join(filter(None, [state, header.reason])), run.silent or header.state == "failed"
    if header.verdict is not None and header.state != "failed":  # a failed run's verdict is its reason, shown above
        usable = header.verdict.usable
        yield "verdict", header.verdict.text if usable else f"not usable: {header.verdict.text}", not usable
    left = "" if left_s is None or not live else f", {clock(left_s)} min left"
    if live or run.rows:
        elapsed_s = time.time() - header.started.timestamp() if live else run.now_s
        yield "time", f"{clock(elapsed_s)} min{left}", False
    if (volts := run.battery_v) is not None:
        yield "battery", f"{volts:.2f} V", volts < _LOW_V
    if (vehicle := run.vehicle_state) is not None:
        text = ": ".join(filter(None, [vehicle.name, vehicle.remedy]))
        yield "vehicle" if live else "vehicle, last seen", text, bool(vehicle.remedy)


def _of_device(device: DeviceRows, counts: Counts | None, live: bool) -> tuple[str, bool]:
    """Return what a device delivered, where it is `live` with its rate; and whether anything of it is missing."""
    texts = [counted(device.rows if counts is None else counts.rows, "row")]
    if counts is not None:
        if live and counts.rate_hz >= 1:  # rarer rows are events
            requested = f" of {device.record.rate_hz:g}" if device.record.rate_hz else ""
            texts.insert(0, f"{counts.rate_hz:.0f}{requested} Hz")
        texts.append("losses unknown" if counts.lost is None else f"{counts.lost} lost")
    if device.unreadable:
        texts.append(f"{counted(device.unreadable, 'byte')} unreadable")
    return ", ".join(texts), bool(device.unreadable or (counts is not None and counts.lost))
