"""Records with known physics, made from closed forms or SciPy, and a view of a drawn page for tests."""

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.integrate import solve_ivp

from cfid.drawing.style import ALERT
from cfid.friction.drops import Drop, measure_drop
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.window import FreeSwing, find_swing

Array = npt.NDArray[np.float64]

RADIUS_M, GRAVITY_MPS2 = 2e-3, 9.81
ENCODER_STEP_RAD = 2 * np.pi / 8192


class Page:
    """A figure, with methods that return what it shows."""

    def __init__(self, figure: Figure) -> None:
        self.figure = figure

    def panel(self, title: str) -> Axes:
        (found,) = (axes for axes in self.figure.axes if axes.get_title(loc="left").startswith(title))
        return found

    def texts(self) -> Iterator[Text]:
        for text in self.figure.findobj(Text):
            if isinstance(text, Text) and text.get_visible() and text.get_text().strip():
                yield text

    def red(self) -> str:
        return " ".join(text.get_text() for text in self.texts() if same_color(text.get_color(), ALERT))

    def overlapping(self) -> list[tuple[str, str]]:
        """Lay out the page and return the pairs of overlapping texts; a text that leaves the page pairs with itself."""
        assert isinstance(self.figure.canvas, FigureCanvasAgg)
        self.figure.draw_without_rendering()
        unseen = {id(text) for axes in self.figure.axes for text in _not_drawn(axes)}
        seen = [text for text in self.texts() if id(text) not in unseen]
        boxes = [(text.get_text(), text.get_window_extent()) for text in seen]
        page = self.figure.bbox
        outside = [(name, name) for name, box in boxes if not (box.x0 >= 0 and box.x1 <= page.x1 and box.y0 >= 0)]
        return outside + [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.padded(-1).overlaps(other)]


def _not_drawn(axes: Axes) -> Iterator[Text]:
    """Yield the labels of ticks beyond an axis' limits, which matplotlib keeps, and all labels of hidden axes."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not (axes.axison and low <= tick.get_loc() <= high):
                yield from (tick.label1, tick.label2)
        if not axes.axison:
            yield axis.label


def swing_record(*, seconds: float = 9.0, wobble_rad: float = 0.0, release_rad: float = 0.8) -> tuple[Array, Array]:
    """Return the record of a 13-bit encoder of a pendulum that is lifted, held, and released at 1 s."""
    time = np.arange(0.0, seconds, 0.002)
    held = time < 1.0

    def motion(_: float, y: Array) -> tuple[float, float]:
        return y[1], -150.0 * np.sin(y[0]) - 0.6 * y[1] - 0.3 * np.tanh(y[1] / 0.01)

    free = solve_ivp(motion, (1.0, seconds), (release_rad, 0.0), t_eval=time[~held], rtol=1e-7, atol=1e-9)
    lifted = release_rad * (1 - np.cos(np.pi * np.clip((time[held] - 0.2) / 0.5, 0, 1))) / 2
    angle = np.concatenate([lifted, free.y[0] + wobble_rad * np.sin(20.0 * time[~held])])
    noisy = angle + 2e-4 * np.random.default_rng(1).standard_normal(len(time)) + 1.3
    return time, np.round(noisy / ENCODER_STEP_RAD) * ENCODER_STEP_RAD


@pytest.fixture(scope="session")
def look() -> Callable[[Figure], Page]:
    return Page


@pytest.fixture(scope="session")
def swing() -> FreeSwing:
    return find_swing(*swing_record(), peaks=7)


@pytest.fixture(scope="session")
def fit(swing: FreeSwing) -> SwingFit:
    return fit_swing(swing)


@pytest.fixture(scope="session")
def shaken() -> tuple[FreeSwing, SwingFit]:
    """A swing whose arm moves by itself, so that no pendulum describes it."""
    found = find_swing(*swing_record(wobble_rad=0.03))
    return found, fit_swing(found)


@pytest.fixture(scope="session")
def drop() -> Callable[..., Drop]:
    """Weights that fall according to eq. 2.13; a ripple keeps the speed from settling."""

    def fall(weight_kg: float, *, ripple: float = 0.0, slower: float = 0.0, seed: int = 0) -> Drop:
        time = np.arange(0.0, 2.5, 0.002)
        speed, tau = 9000.0 * weight_kg * (1 - slower), 0.1
        fallen = np.maximum(time - 0.5, 0.0)
        angle = speed * (fallen + tau * np.expm1(-fallen / tau))
        angle += ripple * np.sin(angle / 1.0) + 1e-3 * np.random.default_rng(seed).standard_normal(len(time))
        return measure_drop(time, angle, weight_kg=weight_kg, radius_m=RADIUS_M, gravity_mps2=GRAVITY_MPS2)

    return fall
