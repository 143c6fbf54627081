"""The document of one viewer: plots of all signals and a spectrum, drawn ten times a second until paused or zoomed."""

import math
from typing import Any

from bokeh.document import Document
from bokeh.events import Reset
from bokeh.layouts import column, row
from bokeh.models import RadioButtonGroup, Range1d, Toggle

from cfid.watch.live_run import LiveRun
from cfid.watch.plots import Colours, SignalPlot, SpectrumPlot
from cfid.watch.watched import Watched

EVERY_MS = 90  # ten pictures a second, with the time that each takes
# The page's script knows these: the tags of the common time axis hold the number of the last picture sent, and the
# script answers there with the number of the last picture drawn.
TIME, SENT = "time", "sent"

_SPANS = {"10 s": 10.0, "60 s": 60.0, "all": math.inf}
_PAUSE, _NEXT_BEGAN = "Pause", "Paused: another run began"
_AHEAD = 1  # pictures that are on their way while the browser draws one
_WRAPPED = {"flex-wrap": "wrap"}


class Picture:
    """What one viewer sees; it follows the recording until it is paused or zoomed."""

    def __init__(self, document: Document, watched: Watched, *, dark: bool) -> None:
        """Draw into a document as long as it has a viewer."""
        self._watched, self._colours = watched, Colours(dark=dark)
        self._run: LiveRun | None = None
        self._plots: list[SignalPlot] = []
        self._spectrum: SpectrumPlot | None = None
        self._drawn: tuple[object, ...] = ()
        self._sent = self._drawn_there = 0
        self._overtaken = False
        self._span = RadioButtonGroup(labels=list(_SPANS), active=0)
        self._span.on_change("active", self._spanned)
        self._pause = Toggle(label=_PAUSE)
        self._time, self._placed = Range1d(0.0, 1.0, name=TIME), [0.0, 1.0]
        self._time.on_change("start", self._zoomed)
        self._time.on_change("end", self._zoomed)
        self._time.on_change("tags", self._answered)
        self._area = row(sizing_mode="stretch_width", styles=_WRAPPED)
        controls = row(self._span, self._pause, styles=_WRAPPED)
        document.add_root(column(controls, self._area, sizing_mode="stretch_width"))
        watched.viewers += 1
        document.on_session_destroyed(self._left)
        document.add_periodic_callback(self.draw, EVERY_MS)
        self.draw()

    def draw(self) -> None:
        """Draw what has been read so far, if anything is new and the browser has drawn the last picture.

        A browser that is slower, or shows another tab, gets fewer pictures, but never late ones.
        """
        if self._sent - self._drawn_there > _AHEAD:
            return
        if self._watched.run is not self._run and self._run is not None and self._pause.active:
            self._pause.label = _NEXT_BEGAN  # a viewer who paused is looking at something: the next run waits
        elif self._watched.run is not self._run:
            self._begin(self._watched.run)
        if self._run is None:
            return
        if not self._pause.active:
            self._move_to(self._newest(self._run.now_s))
        elif self._overtaken:  # pictures that were on their way moved the axis once more
            self._overtaken = False
            self._move_to([math.nextafter(end_s, math.inf) for end_s in self._placed])
        wanted = (self._watched.revision, *self._placed)
        if wanted != self._drawn:
            self._drawn = wanted
            self._sent += 1
            self._time.tags = [SENT, self._sent]
            for plot in self._plots:
                plot.draw(self._placed[0], self._placed[1], self._run.now_s)
        if self._spectrum is not None and not self._pause.active:
            self._spectrum.draw(self._watched.lines)

    def _begin(self, run: LiveRun | None) -> None:
        """Make the plots of another run."""
        self._run, self._drawn = run, ()
        self._pause.active, self._pause.label = False, _PAUSE
        self._plots = [SignalPlot(signal, self._time, self._colours) for signal in (run.signals if run else ())]
        self._spectrum = SpectrumPlot(self._colours) if run and run.loadcell else None
        for plot in self._plots:
            plot.figure.on_event(Reset, self._follow)
        self._area.children = [plot.block for plot in (*self._plots, self._spectrum) if plot is not None]

    def _newest(self, now_s: float) -> list[float]:
        """Return the span of time that ends with the newest rows."""
        span_s = list(_SPANS.values())[self._span.active or 0]
        return [max(now_s - span_s, 0.0), max(now_s, 1.0)]

    def _move_to(self, span_s: list[float]) -> None:
        self._placed = span_s
        self._time.update(start=span_s[0], end=span_s[1])

    def _zoomed(self, end: str, _old: float, new: float) -> None:
        """Stay where the viewer zoomed or moved to; ignore changes that `_move_to` made."""
        place = ("start", "end").index(end)
        if new != self._placed[place]:
            self._overtaken = self._overtaken or not self._pause.active
            self._pause.active = True
            self._placed[place] = float(new)

    def _answered(self, _name: str, _old: list[object], new: list[object]) -> None:
        if new[0] != SENT:
            self._drawn_there = int(str(new[1]))

    def _spanned(self, _name: str, _old: int, _new: int) -> None:
        """Follow the newest rows over another span, even if the picture was paused."""
        self._pause.active = False

    def _follow(self, _event: Any) -> None:
        self._pause.active = False

    def _left(self, _session: object) -> None:
        self._watched.viewers -= 1
