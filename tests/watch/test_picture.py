"""A viewer's picture follows the recording, and stays where it was paused."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import RadioButtonGroup, Range1d, Toggle

from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.watch.live_run import ShownRun
from cfid.watch.picture import TIME, Picture


def swing(folder: Path, *, seconds: float) -> Path:
    record = DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn=8192.0)
    started = datetime.now(UTC)
    time_s = started.timestamp() + np.arange(0, seconds, 0.01)
    with create_run(
        folder, kind="swing", label=Label(), devices={"encoder": record}, started=started, cfid_version="0"
    ) as writer:
        writer.append("encoder", (time_s, np.arange(len(time_s))))
    return writer.folder


class View:
    """A run of 100 s on a viewer's page."""

    def __init__(self, folder: Path) -> None:
        swing(folder, seconds=100)
        self.shown, document = ShownRun(folder=None, runs_folder=folder), Document()
        self.picture = Picture(document, self.shown, dark=False)
        self.turn()
        self.pause, self.spans = (document.select_one({"type": kind}) for kind in (Toggle, RadioButtonGroup))
        self.time = document.select_one({"type": Range1d, "name": TIME})

    def turn(self) -> None:
        """Look for another run, read it, and draw it."""
        self.shown._next_look_s = 0.0
        self.shown.read()
        self.picture.draw()


@pytest.fixture
def view(tmp_path: Path) -> View:
    return View(tmp_path)


def test_a_paused_picture_stays_when_the_next_run_begins(view: View, tmp_path: Path) -> None:
    assert (view.time.start, view.time.end) == pytest.approx((89.99, 99.99))
    view.pause.active = True
    label = view.pause.label
    swing(tmp_path, seconds=30)
    view.turn()
    assert view.pause.active
    assert view.pause.label != label
    assert view.time.end == pytest.approx(99.99)

    view.pause.active = False
    view.turn()
    assert (view.pause.active, view.pause.label) == (False, label)
    assert view.time.end == pytest.approx(29.99)


def test_a_zoom_pauses_at_its_place_and_another_span_follows_again(view: View) -> None:
    view.time.start = 95.0
    view.turn()
    assert view.pause.active
    assert (view.time.start, view.time.end) == pytest.approx((95.0, 99.99))

    view.spans.active = 1
    view.turn()
    assert not view.pause.active
    assert view.time.end - view.time.start == pytest.approx(60.0)
