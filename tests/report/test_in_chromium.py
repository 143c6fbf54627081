"""The page in a real browser: quiet, self-contained, all figures visible, readable at any width, light and dark."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from cfid.drawing.save import save_figure
from cfid.report.render import rendered
from tests.lab import new_campaign
from tests.report.chromium import BROWSER, look_at
from tests.report.fits_by_hand import APPENDIX_A, number, put, put_appendix_a, report_of

pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs Chromium to look at the page with")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    campaign = new_campaign(tmp_path_factory.mktemp("campaign"))
    put_appendix_a(campaign)
    rows = [{"cmd": i, "a_rather_long_name": i / 7, "thrust_n": 1e-5 * i, "note": "left out"} for i in range(20)]
    figures = []
    for name in ("fit_torque", "thrust_of_speed", "inertia_swing", "fit_thrust", "tf_step", "drag_models"):
        figure = Figure(figsize=(7.2, 4))
        figure.add_subplot().plot([1, 3, 2], label=name, gid=name)
        for path in save_figure(figure, campaign.folder / "figures" / name):
            figures.append(str(path.relative_to(campaign.folder)))
    put(
        campaign,
        "torque",
        {**APPENDIX_A["torque"], "motor.table": number(rows, "as named", None)},
        sources=["a_run_with_a_name_that_is_much_longer_than_a_telephone_is_wide"],
        minutes=1,
        figures=tuple(figures),
        rejected="the line leaves too much.",
        warnings=("a point was left out.",),
        lines=("a line of a fit's own words that goes on for quite a while, as those of a staircase of commands do",),
        quality={"chi_squared": 311.0, "wind means": [-4.5931e-10] * 24, "models": {"a": {"condition": 3.0}}},
    )
    return rendered(report_of(campaign), "html", campaign.folder)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_page_is_quiet_and_readable_at_any_width(page: str, dark: bool, tmp_path: Path) -> None:
    assert page.count("data:image") == 6  # the picture of the first screen is not embedded again with its experiment
    looks = look_at(page, tmp_path, widths_px=(1280, 400), dark=dark)

    for width_px, look in looks.items():
        assert look.said == ()
        assert set(look.requests) <= {"/", "/page.html", "/favicon.ico"}  # the icon belongs to the framing page
        assert len(look.figures) == 6
        for figure in look.figures:
            assert figure["natural_px"] > 0
            assert figure["shown_px"] >= 300
            assert figure["height_px"] > 100
            assert 0 <= figure["left_px"] <= width_px - figure["shown_px"]
        assert look.overflow_px <= 0
        assert look.cut == ()
        assert look.faint == ()
        assert look.background == ("rgb(20, 23, 27)" if dark else "rgb(251, 251, 249)")
    assert 500 < looks[1280].pictures_px < 900  # numbers and four pictures in two rows on the first screen
