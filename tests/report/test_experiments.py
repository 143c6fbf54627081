"""Each experiment in a report shows what its fit stored: figures, tables, budget, findings, sources."""

import os
import shutil
from dataclasses import replace
from hashlib import sha256
from typing import Any

from matplotlib.figure import Figure

from cfid.drawing.save import save_figure
from cfid.records.campaign import Campaign
from cfid.records.parameters import Source
from cfid.records.run import Run, State, amend_run
from cfid.report.render import LARGEST_SVG_BYTES, rendered
from tests.lab import keep_instead, made_run
from tests.report.fits_by_hand import APPENDIX_A, number, put, report_of

THRUST = APPENDIX_A["thrust"]


def draw(campaign: Campaign, name: str) -> tuple[str, ...]:
    figure = Figure(figsize=(3, 2))
    figure.add_subplot().plot([1, 2], label=name, gid=name)
    paths = save_figure(figure, campaign.folder / "figures" / name)
    return tuple(str(path.relative_to(campaign.folder)) for path in paths)


def page_of(campaign: Campaign) -> str:
    return rendered(report_of(campaign), "html", campaign.folder)


def tables_of(campaign: Campaign) -> dict[str, list[list[Any]]]:
    return {
        table["title"].partition(":")[0]: table["rows"] for table in report_of(campaign)["experiments"][0]["tables"]
    }


def test_experiments_stand_in_the_order_of_the_thesis_the_latest_first(campaign: Campaign) -> None:
    put(campaign, "drag", APPENDIX_A["drag"], sources=["d"])
    put(campaign, "thrust", THRUST, sources=["a"])
    put(campaign, "thrust", THRUST, sources=["b"], minutes=5)
    put(campaign, "swing x", {"swing.axis_inertia_kg_m2": number(3e-5, "kg m^2")}, sources=["s"], minutes=9)

    assert [experiment["title"] for experiment in report_of(campaign)["experiments"]] == [
        "Swing x",
        "Command to thrust",
        "Command to thrust, earlier: 2026-11-21 12:00",
        "Drag",
    ]


def test_lists_of_rows_are_tables_and_other_figures_of_quality_are_one(campaign: Campaign) -> None:
    quality = {
        "rms": None,
        "left_out": [],
        "condition": 2.6,
        "swings": [{"axis": "x", "drift": 1e-5}, {"axis": "y", "is_late": True}],
        "series": {"motor1": {"runs": 3}},
    }
    parameters = {"motor.table": number([{"cmd": 1000, "thrust_n": 0.01}], "as named", None)}
    put(campaign, "thrust", parameters, sources=["a"], quality=quality)

    assert tables_of(campaign) == {
        "quality of the fit": [["condition", 2.6], ["series motor1 runs", 3]],
        "swings": [["x", 1e-5, None], ["y", None, True]],
        "what was measured at each command": [[1000, 0.01]],
    }


def test_parts_of_an_uncertainty_are_a_row_a_quantity_the_largest_first(campaign: Campaign) -> None:
    slope = {"motor.torque_poly": number([6.0], "Nm(N)", [10.0])}
    effects = {"gain": 9.0, "arm": 3.0, "talk": 2.0, "yaw": 0.1}
    common = {cause: {"motor.torque_poly": [effect]} for cause, effect in effects.items()}
    put(campaign, "torque", slope, sources=["a"], common=common)

    assert tables_of(campaign)["what uncertainties come from"] == [
        ["motor.torque_poly", "gain 81 %, arm 9 %, fit 6 %, others 4 %"]
    ]


def test_a_figure_stands_in_the_page_as_drawing_or_if_it_is_large_as_pixels(campaign: Campaign) -> None:
    put(campaign, "thrust", THRUST, sources=["a"], figures=draw(campaign, "fit_thrust"))
    assert page_of(campaign).count("data:image/svg+xml;base64,") == 1

    svg = campaign.folder / "figures" / "fit_thrust.svg"
    svg.write_bytes(svg.read_bytes() + b" " * LARGEST_SVG_BYTES)
    page = page_of(campaign)
    assert page.count("data:image/png;base64,") == 1
    assert "data:image/svg+xml" not in page

    for path in svg.parent.iterdir():
        path.unlink()
    page = page_of(campaign)
    assert "data:image" not in page
    assert "Figure fit thrust" in page


def test_a_figure_that_a_later_fit_replaced_is_shown_with_the_later_one_alone(campaign: Campaign) -> None:
    figures = draw(campaign, "fit_thrust")
    put(campaign, "thrust", THRUST, sources=["a"], figures=figures)
    put(campaign, "thrust", THRUST, sources=["b"], figures=figures, minutes=1)
    later, earlier = report_of(campaign)["experiments"]

    assert (later["figures"], earlier["figures"]) == (list(figures), [])
    assert len(earlier["notes"]) == 1


def test_two_figures_that_are_the_same_are_shown_once(campaign: Campaign) -> None:
    first = draw(campaign, "recording")
    again = tuple(path.replace("recording", "again") for path in first)
    for path, copy in zip(first, again, strict=True):
        shutil.copyfile(campaign.folder / path, campaign.folder / copy)
    put(campaign, "thrust", THRUST, sources=["a"], figures=first)
    put(campaign, "torque", APPENDIX_A["torque"], sources=["a"], figures=again)
    page = page_of(campaign)

    assert page.count("data:image/") == 1
    assert page.count('href="#experiment-0"') == 2  # in the contents, and in place of the second figure


def test_runs_and_fits_that_cannot_be_read_are_named(campaign: Campaign) -> None:
    campaign.fits_folder.mkdir()
    (campaign.fits_folder / "2026-11-21_120000_thrust.json").write_text("{")
    broken = campaign.runs_folder / "2026-11-21_120000_swing_x"
    broken.mkdir(parents=True)
    (broken / "run.toml").write_text("kind = 3")

    unreadable = report_of(campaign)["unreadable"]
    assert len(unreadable) == 2
    for form in ("html", "md"):
        assert "thrust.json" in rendered(report_of(campaign), form, campaign.folder)


def thrust_run(campaign: Campaign, state: State, **more: Any) -> Run:
    return made_run(campaign.folder, "thrust", {"loadcell": {"t": [1.7e9], "fz": [0]}}, state=state, **more)


def counts_of(campaign: Campaign) -> tuple[int, int, int]:
    about = report_of(campaign)["about"]
    return about["runs"], about["growing_runs"], about["unused_runs"]


def test_a_fit_of_a_recording_that_changed_or_was_excluded_is_no_longer_current(campaign: Campaign) -> None:
    def outdated() -> list[str]:
        entries = [entry for group in report_of(campaign)["sheet"] for entry in group["quantities"]]
        return list(next(entry["origin"]["findings"] for entry in entries if entry["keys"] == ["motor.thrust_poly"]))

    run = thrust_run(campaign, "complete")
    file = run.device_file("loadcell")
    fitted = Source(f"runs/{run.folder.name}/loadcell.csv", sha256(file.read_bytes()).hexdigest())
    fit = put(campaign, "thrust", THRUST)
    keep_instead(campaign.folder, "thrust", replace(fit.section, sources=(fitted,)))
    assert outdated() == []
    assert fitted.sha256 in page_of(campaign)
    assert counts_of(campaign) == (1, 0, 0)

    file.write_text("t,fz\n1,2\n")
    amend_run(run, excluded="the cable touched")
    changed, excluded = outdated()
    assert fitted.path in changed
    assert "(the cable touched)" in excluded
    assert counts_of(campaign) == (1, 0, 1)


def test_runs_that_grow_or_were_cut_are_counted_and_a_completed_one_is_used(campaign: Campaign) -> None:
    run = thrust_run(campaign, "complete")
    header = run.folder / "run.toml"
    header.write_text(header.read_text().replace('state = "complete"', 'state = "recording"'))
    assert counts_of(campaign) == (1, 1, 0)
    os.utime(run.device_file("loadcell"), (0, 0))
    assert counts_of(campaign) == (1, 0, 1)
    assert [row["state"] for row in report_of(campaign)["runs"]] == ["cut"]

    later = thrust_run(campaign, "interrupted")
    assert counts_of(campaign) == (2, 0, 2)
    thrust_run(campaign, "complete", requested={"resumes": later.folder.name})
    assert counts_of(campaign) == (3, 0, 1)
