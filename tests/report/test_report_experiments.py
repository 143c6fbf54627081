"""Each experiment in a report shows what its fit stored: figures, windows, budget, warnings, origin."""

import os
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from cfid.drawing.save import save_figure
from cfid.records.campaign import Campaign
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Label, amend_run
from cfid.records.run_writer import RunWriter, create_run
from cfid.report.formats.html import LARGEST_SVG_BYTES, as_html
from tests.lab import keep_instead
from tests.report.fits_by_hand import APPENDIX_A, NOON, new_campaign, number, put, report_of


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return new_campaign(tmp_path)


def draw(campaign: Campaign, name: str, *, points: int = 2) -> tuple[str, ...]:
    figure = Figure(figsize=(3, 2))
    figure.add_subplot().plot([0.1234567 * (i % 7) for i in range(points)], label=name, gid=name)
    paths = save_figure(figure, campaign.folder / "figures" / name)
    return tuple(str(path.relative_to(campaign.folder)) for path in paths)


def page_of(campaign: Campaign) -> str:
    return as_html(report_of(campaign), campaign.folder)


def test_experiments_stand_in_the_order_of_the_thesis_the_latest_first(campaign: Campaign) -> None:
    put(campaign, "drag", APPENDIX_A["drag"], sources=["d"])
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"])
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["b"], minutes=5)
    put(campaign, "swing x", {"swing.axis_inertia_kg_m2": number(3e-5, "kg m^2")}, sources=["s"], minutes=9)

    assert [one.title for one in report_of(campaign).experiments] == [
        "Swing x",
        "Command to thrust",
        "Command to thrust, earlier: 2026-11-21 12:00",
        "Drag",
    ]


def test_a_budget_is_a_table_with_a_row_for_each_input(campaign: Campaign) -> None:
    share = [[1e-9, 2e-9, 3e-9], [2e-9, 4e-9, 5e-9], [3e-9, 5e-9, 6e-9]]
    quality = {"rms": None, "condition": 2.6, "budget_kg_m2": {"mass": share, "gravity": share}}
    put(campaign, "inertia", APPENDIX_A["inertia"], sources=["a"], quality=quality)
    facts, budget = report_of(campaign).experiments[0].tables

    assert facts.rows == (("condition", 2.6),)
    assert budget.title.startswith("uncertainty budget")
    assert budget.columns == ("", "xx", "yy", "zz", "xy", "xz", "yz")
    assert budget.rows[0] == ("mass", 1e-9, 4e-9, 6e-9, 2e-9, 3e-9, 5e-9)


def test_lists_of_rows_are_tables_whatever_they_hold(campaign: Campaign) -> None:
    quality = {"swings": [{"axis": "x", "drift": 1e-5}, {"axis": "y", "believed": True}], "series": {"a": {"runs": 3}}}
    parameters = {"motor.table": number([{"cmd": 1000, "thrust_n": 0.01}], "as named", None)}
    put(campaign, "thrust", parameters, sources=["a"], quality=quality)
    tables = {table.title: table for table in report_of(campaign).experiments[0].tables}

    assert tables["swings: window and verdict of each"].rows == (("x", 1e-5, None), ("y", None, True))
    assert tables["series"].rows == (("a", 3),)
    assert tables["what was measured at each command"].rows == ((1000, 0.01),)


def test_a_figure_stands_in_the_page_itself(campaign: Campaign) -> None:
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=draw(campaign, "fit_thrust"))

    assert page_of(campaign).count("data:image/svg+xml;base64,") == 1


def test_a_figure_with_very_many_points_is_taken_as_pixels(campaign: Campaign) -> None:
    figures = draw(campaign, "fit_thrust")
    svg = campaign.folder / "figures" / "fit_thrust.svg"
    svg.write_bytes(svg.read_bytes() + b" " * LARGEST_SVG_BYTES)
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=figures)

    assert "data:image/png;base64," in page_of(campaign)
    assert "data:image/svg+xml" not in page_of(campaign)


def test_a_figure_whose_file_is_gone_is_named(campaign: Campaign) -> None:
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=("figures/gone.png", "figures/gone.svg"))

    assert "Figure gone: it has no file that can be shown." in page_of(campaign)


def test_a_figure_that_a_later_fit_drew_over_is_shown_for_the_later_one_alone(campaign: Campaign) -> None:
    figures = draw(campaign, "fit_thrust")
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=figures)
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["b"], figures=figures, minutes=1)
    later, earlier = report_of(campaign).experiments

    assert (later.figures, earlier.figures) == (figures, ())
    assert earlier.notes == ("1 of its figures was replaced by a later fit's.",)


def test_two_figures_that_are_the_same_are_shown_once(campaign: Campaign) -> None:
    first = draw(campaign, "recording")
    for path in first:
        copy = campaign.folder / path.replace("recording", "again")
        copy.write_bytes((campaign.folder / path).read_bytes())
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=first)
    put(
        campaign,
        "torque",
        APPENDIX_A["torque"],
        sources=["a"],
        figures=tuple(p.replace("recording", "again") for p in first),
    )
    page = page_of(campaign)

    assert page.count("data:image/") == 1
    assert "Figure again: the same as under" in page


def test_every_source_stands_with_its_hash(campaign: Campaign) -> None:
    fit = put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a", "b"])
    page = page_of(campaign)

    for source in fit.section.sources:
        assert source.path in page
        assert source.sha256 in page


def test_runs_and_fits_that_cannot_be_read_are_named(campaign: Campaign) -> None:
    campaign.fits_folder.mkdir()
    (campaign.fits_folder / "2026-11-21_120000_thrust.json").write_text("{")
    broken = campaign.runs_folder / "2026-11-21_120000_swing_x"
    broken.mkdir(parents=True)
    (broken / "run.toml").write_text("kind = 3")

    assert len(report_of(campaign).unreadable) == 2
    assert "What could not be read" in page_of(campaign)


def begun(campaign: Campaign, kind: str, device: str, file: str, *columns: str, **requested: Any) -> RunWriter:
    """Start a run with one device, and return its writer."""
    return create_run(
        campaign.runs_folder,
        kind=kind,
        label=Label(),
        devices={device: DeviceRecord(file=file, columns=columns)},
        started=NOON,
        cfid_version="0",
        requested=requested,
    )


def test_a_fit_of_a_recording_that_changed_or_was_excluded_since_is_no_longer_current(campaign: Campaign) -> None:
    writer = begun(campaign, "thrust", "loadcell", "data.csv", "t", "fz")
    run = writer.close("complete")
    file = run.device_file("loadcell")
    fitted = Source(f"runs/{run.folder.name}/data.csv", sha256(file.read_bytes()).hexdigest())
    fit = put(campaign, "thrust", APPENDIX_A["thrust"])
    keep_instead(campaign.folder, "thrust", replace(fit.section, sources=(fitted,)))
    assert not said_of_thrust(campaign)
    assert report_of(campaign).about.recorded_in == "1 run"

    file.write_text("t,fz\n1,2\n")
    amend_run(run, excluded="the cable touched")
    assert said_of_thrust(campaign) == (
        f"Changed since it was fitted: {fitted.path}: fit again.",
        f"Fitted to runs that are now excluded: {run.folder.name} (the cable touched): fit again without them.",
    )
    assert "in 1 run, 1 of them not usable or excluded." in page_of(campaign)


def test_a_run_that_is_being_recorded_is_counted_as_that_and_one_that_was_cut_as_not_usable(
    campaign: Campaign, tmp_path: Path
) -> None:
    writer = begun(campaign, "ping", "pings", "pings.csv", "t", "rtt")
    writer.append("pings", ([1.7e9], [0.01]))
    assert report_of(campaign).about.recorded_in == "1 run, 1 of them being recorded"
    assert [run.state for run in report_of(campaign).runs] == ["recording"]

    os.utime(writer.folder / "pings.csv", (0, 0))
    cut = shutil.copytree(writer.folder, tmp_path / "cut")
    writer.close("complete")
    shutil.rmtree(writer.folder)
    shutil.copytree(cut, writer.folder)
    assert report_of(campaign).about.recorded_in == "1 run, 1 of them not usable or excluded"
    assert [run.state for run in report_of(campaign).runs] == ["cut"]


def test_a_run_that_a_usable_one_completes_is_not_counted_as_not_usable(campaign: Campaign) -> None:
    def written(state: Any, **requested: Any) -> str:
        writer = begun(campaign, "thrust", "commands", "commands.csv", "t", "m1", **requested)
        writer.append("commands", ([1.7e9], [0]))
        return writer.close(state).folder.name

    first = written("interrupted")
    assert report_of(campaign).about.recorded_in == "1 run, 1 of them not usable or excluded"
    written("complete", resumes=first)
    assert report_of(campaign).about.recorded_in == "2 runs"


def said_of_thrust(campaign: Campaign) -> tuple[str, ...]:
    quantities = [quantity for group in report_of(campaign).sheet for quantity in group.quantities]
    (origin,) = (one.origin for one in quantities if one.keys == ("motor.thrust_poly",))
    assert origin is not None
    return origin.findings
