"""The plots of a page: signals over time, and the spectrum."""

from html import escape

import numpy as np
from bokeh.layouts import column
from bokeh.models import Column, ColumnDataSource, DataRange1d, Div, HoverTool, Range1d
from bokeh.plotting import figure

from cfid.watch.signals import Trace
from cfid.watch.spectrum import HIGHEST_HZ, RotorLines

BINS = 400  # of a signal in a picture: a plot is some 400 pixels wide

_WIDTH_PX, _HEIGHT_PX = 320, 230
_LABEL_ROOM = 0.25  # above the highest line, as a fraction of its height
_MARKED = 40  # each point of a picture with at most this many is marked: a line alone hides typed readings
_TOOLS = "xpan,xwheel_zoom,xbox_zoom,reset"


class Colours:
    """The colours of a page, light or dark."""

    def __init__(self, *, dark: bool) -> None:
        """Choose the colours; text and lines have a contrast of at least 4.5 to the page."""
        self.text, self.grid = ("#d8dce1", "#353b43") if dark else ("#1f2328", "#d9dde2")
        self.lines = (
            ("#6cb2ff", "#ff9a62", "#5fd08c", "#c79bff", "#e3c34a", "#9aa4af")
            if dark
            else ("#0b62c4", "#b8400c", "#0b7a3b", "#7a3bb0", "#7d6200", "#57606a")
        )

    def line(self, k: int) -> str:
        """Return the colour of the k-th curve."""
        return self.lines[k % len(self.lines)]


class SignalPlot:
    """Curves of a signal over time."""

    def __init__(self, signal: Trace, time_range: Range1d, colours: Colours) -> None:
        """Make the plot; all plots share its time axis."""
        self._signal = signal
        self._source, self._marks = (
            ColumnDataSource({"t": [], **{name: [] for name in signal.names}}) for _ in range(2)
        )
        self.figure = _figure("s", colours, x_range=time_range)
        draw = self.figure.step if signal.steps else self.figure.line
        more = {"mode": "after"} if signal.steps else {}
        for k, name in reversed([*enumerate(signal.names)]):  # a rotor shakes Fz most: it would cover Fx and Fy
            draw("t", name, source=self._source, color=colours.line(k), line_width=1.3, **more)
            self.figure.scatter("t", name, source=self._marks, color=colours.line(k), size=5)
        _finish(self.figure, colours)
        self.block = _block(self.figure, signal.title, signal.unit, signal.names, colours)

    def draw(self, begin_s: float, end_s: float, now_s: float) -> None:
        """Draw a span of time; the last of `steps` extends to `now_s`."""
        seen = self._signal.extremes.view(begin_s, end_s, BINS)
        time_s, values = (seen.time_s, seen.low) if self._signal.steps else seen.zigzag()
        if self._signal.steps and len(time_s):
            time_s, values = np.append(time_s, max(now_s, time_s[-1])), np.vstack([values, values[-1:]])
        self._source.data = {"t": time_s, **dict(zip(self._signal.names, values.T.copy(), strict=True))}
        if not self._signal.steps:
            few = len(time_s) <= _MARKED
            self._marks.data = dict(self._source.data) if few else {name: [] for name in self._source.data}


class SpectrumPlot:
    """Amplitudes of the force over frequency, with labels at the rotors' lines."""

    def __init__(self, colours: Colours) -> None:
        """Make the plot."""
        self._drawn: RotorLines | None = None
        self._source = ColumnDataSource({"f": [], "a": []})
        self._lines = ColumnDataSource({"f": [], "a": [], "label": []})
        self.figure = _figure("Hz", colours, x_range=(0.0, HIGHEST_HZ), y_range=DataRange1d(start=0.0))
        self.figure.y_range.range_padding = _LABEL_ROOM
        self.figure.line("f", "a", source=self._source, color=colours.line(0), line_width=1.2)
        self.figure.scatter("f", "a", source=self._lines, color=colours.line(1), size=7)
        self.figure.text(
            "f", "a", "label", source=self._lines, text_color=colours.line(1), text_font_size="12px", x_offset=6
        )
        _finish(self.figure, colours)
        self.block = _block(self.figure, "spectrum of the force", "mN", (), colours)

    def draw(self, lines: RotorLines | None) -> None:
        """Draw a spectrum, unless it is drawn already."""
        if lines is None or lines is self._drawn:
            return
        if self._drawn is None:
            self.figure.x_range.end = float(lines.frequency_hz[-1])
        self._drawn = lines
        self._source.data = {"f": lines.frequency_hz, "a": 1e3 * lines.force_n}
        self._lines.data = {
            "f": [line.frequency_hz for line in lines.rotors],
            "a": [1e3 * line.force_n for line in lines.rotors],
            "label": [f"{line.label} {line.frequency_hz:.0f} Hz" for line in lines.rotors],
        }


def _figure(x_unit: str, colours: Colours, **more: object) -> figure:
    plot = figure(
        x_axis_label=x_unit,
        height=_HEIGHT_PX,
        min_width=_WIDTH_PX,
        sizing_mode="stretch_width",
        tools=_TOOLS,
        active_scroll="xwheel_zoom",
        active_drag="xpan",
        background_fill_alpha=0,
        border_fill_alpha=0,
        outline_line_color=colours.grid,
        **more,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    return plot


def _finish(plot: figure, colours: Colours) -> None:
    """Colour what exists only once the curves exist, and show values under the pointer."""
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = colours.text
    plot.axis.axis_line_color = plot.axis.major_tick_line_color = plot.axis.minor_tick_line_color = colours.text
    plot.grid.grid_line_color = colours.grid
    plot.add_tools(HoverTool(mode="vline", tooltips=[(plot.xaxis[0].axis_label, "$x{0.000}"), ("value", "$y{0.000}")]))


def _block(plot: figure, title: str, unit: str, names: tuple[str, ...], colours: Colours) -> Column:
    """Return a plot below its title and the names of its curves.

    Bokeh redraws its own legend with every update of the data, which takes a quarter of a picture's time.
    """
    curves = "".join(
        f' <span style="color: {colours.line(k)}">{escape(name)}</span>'
        for k, name in enumerate(names)
        if len(names) > 1
    )
    words = f"<b>{escape(f'{title}, {unit}' if unit else title)}</b>{curves}"
    heading = Div(text=words, styles={"color": colours.text, "font-size": "13px", "overflow-wrap": "anywhere"})
    return column(heading, plot, sizing_mode="stretch_width", styles={"flex": f"1 1 {_WIDTH_PX}px"})
