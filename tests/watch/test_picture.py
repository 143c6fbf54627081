"""A viewer's picture follows the recording, and stays where it was paused."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import RadioButtonGroup, Range1d, Toggle

from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.watch.picture import TIME, Picture
from cfid.watch.watched import Watched

Seen = tuple[Picture, Watched, Document]


def swing(folder: Path, *, seconds: float) -> Path:
    record = DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn=8192.0)
    started = datetime.now(UTC)
    time_s = started.timestamp() + np.arange(0, seconds, 0.01)
    with create_run(
        folder, kind="swing", label=Label(), devices={"encoder": record}, started=started, cfid_version="0"
    ) as writer:
        writer.append("encoder", (time_s, np.arange(len(time_s))))
    return writer.folder


@pytest.fixture
def viewed(tmp_path: Path) -> Seen:
    """Return the picture of a run of 100 s, with the watched folder and the document."""
    swing(tmp_path, seconds=100)
    watched, document = Watched(folder=None, runs_folder=tmp_path), Document()
    picture = Picture(document, watched, dark=False)
    read_until(watched, lambda: watched.run is not None and watched.run.now_s > 99)
    picture.draw()
    return picture, watched, document


def read_until(watched: Watched, done: Callable[[], bool]) -> None:
    for _ in range(1000):
        watched._next_look_s = 0.0
        watched.read()
        if done():
            return
    pytest.fail("the run was not read")


def shown(document: Document) -> tuple[float, float]:
    """Answer like a browser that drew the last picture; return the start and the end of the time that it shows."""
    span = document.select_one({"type": Range1d, "name": TIME})
    assert isinstance(span, Range1d)
    if span.tags:
        span.tags = ["drawn", span.tags[1]]
    return float(span.start), float(span.end)


def test_a_paused_picture_stays_when_the_next_run_begins_and_names_it(viewed: Seen, tmp_path: Path) -> None:
    picture, watched, document = viewed
    pause = document.select_one({"type": Toggle})
    assert isinstance(pause, Toggle)
    pause.active = True
    before = shown(document)
    first = watched.run
    swing(tmp_path, seconds=30)
    read_until(watched, lambda: watched.run is not first)
    picture.draw()
    assert (pause.active, pause.label) == (True, "Paused: another run began")
    assert shown(document) == before

    pause.active = False
    picture.draw()
    assert (pause.active, pause.label) == (False, "Pause")
    assert shown(document)[1] < 31


def test_another_span_follows_the_newest_rows_again(viewed: Seen) -> None:
    picture, _, document = viewed
    pause, span = document.select_one({"type": Toggle}), document.select_one({"type": RadioButtonGroup})
    assert isinstance(pause, Toggle)
    assert isinstance(span, RadioButtonGroup)
    pause.active = True
    span.active = 1
    picture.draw()
    begin, end = shown(document)
    assert not pause.active
    assert end - begin == pytest.approx(60.0)
