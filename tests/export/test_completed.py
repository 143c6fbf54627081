"""An export takes a published value for what was not measured, where the user agrees, and marks it as such."""

from pathlib import Path

import pytest

from cfid.demo.brushless import state_measured
from cfid.errors import ConfigError
from cfid.export.derived import Derived
from cfid.export.target import refuse, warnings
from cfid.export.vehicle import with_published
from cfid.published import published_sets
from tests.export import thesis_vehicle as thesis
from tests.export.reading import TARGETS
from tests.lab import Cfid

TORQUE = "motor.torque_poly"


def test_a_published_torque_fills_an_export_and_is_marked() -> None:
    lacking = thesis.vehicle(TORQUE)
    assert TARGETS["mujoco"].missing(lacking)
    filled = with_published(lacking, TORQUE, published_sets()["firmware-brushless"])
    assert not TARGETS["mujoco"].missing(filled)
    assert Derived(filled).moment_per_thrust_m == pytest.approx(0.00569278844)
    refuse(TARGETS["mujoco"], filled, None)
    (mark,) = [text for text in warnings(TARGETS["mujoco"], filled) if text.startswith("PUBLISHED: ")]
    assert "firmware-brushless" in mark


@pytest.mark.parametrize("key", [TORQUE, "drag.simple_kg_per_rad", "tf.static_gain_n"])
def test_what_was_measured_has_directions_or_no_place_is_not_replaced(key: str) -> None:
    known = thesis.vehicle() if key == TORQUE else thesis.vehicle(key)
    with pytest.raises(ConfigError):
        with_published(known, key, published_sets()["thesis"])


def test_a_campaign_of_a_brushless_takes_its_platforms_set(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", "mine", "--kind", "owner", "--platform", "cf21bl").returncode == 0
    rig = tmp_path / "mine" / "rig.toml"
    assert 'platform = "cf21bl"' in rig.read_text()
    state_measured(rig)
    listed = cfid("export", "list", "--published", "torque", folder=tmp_path / "mine")
    assert listed.returncode == 0, listed.stderr
    assert not any("MISSING" in line and "torque" in line for line in listed.stdout.splitlines())
    unknown = cfid("export", "list", "--published", "torque=nobody", folder=tmp_path / "mine")
    assert unknown.returncode == 2
    from_set = cfid("export", "list", "--from", "thesis", "--published", "torque", folder=tmp_path / "mine")
    assert from_set.returncode == 2
