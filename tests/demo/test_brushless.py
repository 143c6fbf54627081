"""The demo of a Brushless' owner ends with every export complete, and finds the vehicle that hung and flew."""

import subprocess
from pathlib import Path
from typing import Any

import pytest

from cfid.demo import brushless
from cfid.demo.fits import compared
from cfid.export.target import targets
from cfid.guide.status import status_of
from cfid.records.campaign import open_campaign
from tests.demo.test_demo import command


@pytest.mark.slow
def test_a_demo_of_a_brushless_leaves_no_export_incomplete(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    done = subprocess.run(
        command(folder, "--platform", "cf21bl", "--no-figures"), capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
    campaign, truth = open_campaign(folder), brushless.owned_truth()
    names = {target.file_name for target in targets(folder)[0].values()}
    assert len(names) == 19
    assert names <= {path.name for path in (folder / "exports").iterdir()}
    assert status_of(campaign).next.words == ("report",)
    vehicle = brushless.flying(truth, campaign.rig, seed=1)
    rows = {name: values for name, *values in compared(campaign.values(), brushless.true_values(truth, vehicle))}
    found: dict[str, Any] = {name: values for name, values in rows.items() if not name.startswith("dynamics.")}
    lags: dict[str, Any] = {name: values for name, values in rows.items() if name not in found}
    assert len(found) == 15
    assert [name for name, (true, value, std) in found.items() if std is None or abs(value - true) > 3 * std] == []
    for way in ("rising", "falling"):  # of a lag's two coefficients, the errors cancel at the speed of hovering
        (one, found_one, _), (two, found_two, _) = (lags[f"dynamics.{way} [{place}]"] for place in (0, 1))
        speeds = 2 * vehicle.hover_rad_s
        assert found_one + found_two * speeds == pytest.approx(one + two * speeds, rel=0.02)
