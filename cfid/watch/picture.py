"""The document of one viewer: plots of all signals and a spectrum, drawn five times a second until paused or zoomed."""

import math
from html import escape
from typing import NamedTuple

import numpy as np
from bokeh.document import Document
from bokeh.events import Reset
from bokeh.layouts import column, row
from bokeh.models import Column, ColumnDataSource, DataRange1d, Div, HoverTool, RadioButtonGroup, Range1d, Toggle
from bokeh.plotting import figure

from cfid.watch.live_run import LiveRun, ShownRun
from cfid.watch.signals import Trace
from cfid.watch.spectrum import HIGHEST_HZ, RotorLines

EVERY_MS = 200  # a browser without a graphics card takes some 60 ms for a picture
BINS = 400  # of a signal in a picture: a plot is some 400 pixels wide
TIME = "time"  # the name of the time axis that all plots share

_SPANS = {"10 s": 10.0, "60 s": 60.0, "all": math.inf}
_PAUSE, _NEXT_BEGAN = "Pause", "Paused: another run began"
_WRAPPED = {"flex-wrap": "wrap"}
_WIDTH_PX, _HEIGHT_PX = 320, 230


class Colours(NamedTuple):
    """The colours of a page; text and lines have a contrast of at least 4.5 to it."""

    text: str
    grid: str
    lines: tuple[str, ...]


LIGHT = Colours("#1f2328", "#d9dde2", ("#0b62c4", "#b8400c", "#0b7a3b", "#7a3bb0", "#7d6200", "#57606a"))
DARK = Colours("#d8dce1", "#353b43", ("#6cb2ff", "#ff9a62", "#5fd08c", "#c79bff", "#e3c34a", "#9aa4af"))


class Picture:
    """What one viewer sees; it follows the recording until it is paused or zoomed."""

    def __init__(self, document: Document, shown: ShownRun, *, dark: bool) -> None:
        """Draw into a document as long as it has a viewer."""
        self._shown, self._colours = shown, DARK if dark else LIGHT
        self._run: LiveRun | None = None
        self._plots: list[SignalPlot] = []
        self._spectrum: SpectrumPlot | None = None
        self._drawn: tuple[object, ...] = ()
        self._overtaken = False
        self._span = RadioButtonGroup(labels=list(_SPANS), active=0)
        self._span.on_change("active", lambda _name, _old, _new: self._follow())
        self._pause = Toggle(label=_PAUSE)
        self._time, self._placed = Range1d(0.0, 1.0, name=TIME), [0.0, 1.0]
        for end in ("start", "end"):
            self._time.on_change(end, self._zoomed)
        self._area = row(sizing_mode="stretch_width", styles=_WRAPPED)
        controls = row(self._span, self._pause, styles=_WRAPPED)
        document.add_root(column(controls, self._area, sizing_mode="stretch_width"))
        shown.viewers += 1
        document.on_session_destroyed(self._left)
        document.add_periodic_callback(self.draw, EVERY_MS)
        self.draw()

    def draw(self) -> None:
        """Draw what has been read so far, if anything is new."""
        if self._shown.run is not self._run and self._run is not None and self._pause.active:
            self._pause.label = _NEXT_BEGAN  # a viewer who paused is looking at something: the next run waits
        elif self._shown.run is not self._run:
            self._begin(self._shown.run)
        if self._run is None:
            return
        if not self._pause.active:
            now_s, span_s = self._run.now_s, list(_SPANS.values())[self._span.active or 0]
            self._move_to([max(now_s - span_s, 0.0), max(now_s, 1.0)])
        elif self._overtaken:  # a picture that was on its way when the viewer zoomed moved the axis once more
            self._overtaken = False
            self._move_to([math.nextafter(end_s, math.inf) for end_s in self._placed])  # Bokeh sends no equal values
        wanted = (self._run.rows, *self._placed)
        if wanted != self._drawn:
            self._drawn = wanted
            for plot in self._plots:
                plot.draw(self._placed[0], self._placed[1], self._run.now_s)
        if self._spectrum is not None and not self._pause.active:
            self._spectrum.draw(self._shown.spectrum)

    def _begin(self, run: LiveRun | None) -> None:
        """Make the plots of another run."""
        self._run, self._drawn = run, ()
        self._pause.active, self._pause.label = False, _PAUSE
        self._plots = [SignalPlot(signal, self._time, self._colours) for signal in (run.signals if run else ())]
        self._spectrum = SpectrumPlot(self._colours) if run and run.force else None
        for plot in self._plots:
            plot.figure.on_event(Reset, self._follow)
        self._area.children = [plot.block for plot in (*self._plots, self._spectrum) if plot is not None]

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

    def _follow(self) -> None:
        """Follow the newest rows, maybe over another span, even if the picture was paused."""
        self._pause.active = False

    def _left(self, _session: object) -> None:
        self._shown.viewers -= 1


class SignalPlot:
    """Curves of a signal over time."""

    def __init__(self, signal: Trace, time_range: Range1d, colours: Colours) -> None:
        """Make the plot; all plots share its time axis."""
        self._signal = signal
        self.source = ColumnDataSource({name: [] for name in ("t", *signal.names)})
        title = f"{signal.title}, {signal.unit}" if signal.unit else signal.title
        self.figure, self.block = _framed("s", title, signal.names, colours, x_range=time_range)
        for k, name in reversed([*enumerate(signal.names)]):  # a rotor shakes Fz most: it would cover Fx and Fy
            look = {"source": self.source, "color": colours.lines[k % len(colours.lines)]}
            if signal.style == "steps":
                self.figure.step("t", name, mode="after", line_width=1.3, **look)
            else:
                self.figure.line("t", name, line_width=1.3, **look)
            if signal.style == "marks":
                self.figure.scatter("t", name, size=5, **look)

    def draw(self, begin_s: float, end_s: float, now_s: float) -> None:
        """Draw a span of time; the last of `steps` extends to `now_s`."""
        seen = self._signal.extremes.view(begin_s, end_s, BINS)
        steps = self._signal.style == "steps"
        time_s, values = (seen.time_s, seen.low) if steps else seen.zigzag()
        if steps and len(time_s):
            time_s, values = np.append(time_s, max(now_s, time_s[-1])), np.vstack([values, values[-1:]])
        self.source.data = {"t": time_s, **dict(zip(self._signal.names, values.T.copy(), strict=True))}


class SpectrumPlot:
    """Amplitudes of the force over frequency, with labels at the rotors' lines."""

    def __init__(self, colours: Colours) -> None:
        """Make the plot."""
        self._drawn: RotorLines | None = None
        self._source = ColumnDataSource({"f": [], "a": []})
        self._rotors = ColumnDataSource({"f": [], "a": [], "label": []})
        curve, mark = colours.lines[:2]
        height = DataRange1d(start=0.0, range_padding=0.25)  # room for the label above the highest line
        ranges = {"x_range": (0.0, HIGHEST_HZ), "y_range": height}
        self.figure, self.block = _framed("Hz", "spectrum of the force, mN", (), colours, **ranges)
        self.figure.line("f", "a", source=self._source, color=curve, line_width=1.2)
        self.figure.scatter("f", "a", source=self._rotors, color=mark, size=7)
        self.figure.text("f", "a", "label", source=self._rotors, text_color=mark, text_font_size="12px", x_offset=6)

    def draw(self, lines: RotorLines | None) -> None:
        """Draw a spectrum, unless it is drawn already."""
        if lines is None or lines is self._drawn:
            return
        if self._drawn is None:
            self.figure.x_range.end = float(lines.frequency_hz[-1])
        self._drawn = lines
        self._source.data = {"f": lines.frequency_hz, "a": lines.height}
        self._rotors.data = {
            "f": [frequency_hz for frequency_hz, _, _ in lines.rotors],
            "a": [height for _, height, _ in lines.rotors],
            "label": [f"{name} {frequency_hz:.0f} Hz" for frequency_hz, _, name in lines.rotors],
        }


def _framed(
    x_unit: str, title: str, names: tuple[str, ...], colours: Colours, **ranges: object
) -> tuple[figure, Column]:
    """Return an empty plot, and a block of it below its title and the names of its curves.

    Bokeh redraws its own legend with every update of the data, which takes a quarter of a picture's time.
    """
    plot = figure(
        x_axis_label=x_unit,
        height=_HEIGHT_PX,
        min_width=_WIDTH_PX,
        sizing_mode="stretch_width",
        tools="xpan,xwheel_zoom,xbox_zoom,reset",
        active_scroll="xwheel_zoom",
        active_drag="xpan",
        background_fill_alpha=0,
        border_fill_alpha=0,
        outline_line_color=colours.grid,
        **ranges,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = colours.text
    plot.axis.axis_line_color = plot.axis.major_tick_line_color = plot.axis.minor_tick_line_color = colours.text
    plot.grid.grid_line_color = colours.grid
    plot.add_tools(HoverTool(mode="vline", tooltips=[(x_unit, "$x{0.000}"), ("value", "$y{0.000}")]))
    curves = "".join(
        f' <span style="color: {colours.lines[k % len(colours.lines)]}">{escape(name)}</span>'
        for k, name in enumerate(names)
        if len(names) > 1
    )
    look = {"color": colours.text, "font-size": "13px", "overflow-wrap": "anywhere"}
    heading = Div(text=f"<b>{escape(title)}</b>{curves}", styles=look)
    return plot, column(heading, plot, sizing_mode="stretch_width", styles={"flex": f"1 1 {_WIDTH_PX}px"})
