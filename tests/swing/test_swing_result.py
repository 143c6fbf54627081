"""Results of `cfid.swing.fit` in a notebook: frequency, inertia and torques, each with its standard uncertainty."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cfid.swing
from cfid.errors import ConfigError
from cfid.recordings.angle import AngleRecord, labelled
from cfid.records.rig_file import thesis_rig
from cfid.records.run import Label
from tests.drawn import swing_record
from tests.lab import new_campaign
from tests.recordings.made import made_angle

# The pendulum of tests.drawn: W, and damping per inertia.
FREQUENCY, VISCOUS, COULOMB = 150.0, 0.6, 0.3


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> AngleRecord:
    return made_angle(*swing_record(), path=tmp_path_factory.mktemp("alone") / "encoder.csv")


def test_mass_and_distance_make_an_inertia_and_torques_within_three_uncertainties(record: AngleRecord) -> None:
    result = cfid.swing.fit(record, mass_kg=0.03, distance_m=0.02, gravity_mps2=9.8)
    inertia = 0.03 * 9.8 * 0.02 / FREQUENCY

    assert result.accepted
    for key, true in (
        ("natural_frequency_squared_s2", FREQUENCY),
        ("axis_inertia_kg_m2", inertia),
        ("viscous_nms_per_rad", VISCOUS * inertia),
        ("coulomb_nm", COULOMB * inertia),
    ):
        found = result.quantities[f"swing.{key}"]
        assert abs(found.value - true) < 3 * found.std, key


def test_the_rig_is_that_of_the_campaign_that_the_recording_lies_in(record: AngleRecord, tmp_path: Path) -> None:
    new_campaign(tmp_path)
    (tmp_path / "runs").mkdir()
    within = labelled(replace(record, path=tmp_path / "runs" / "encoder.csv"), axis="z")
    rig = thesis_rig()
    given = cfid.swing.fit(labelled(record, axis="z"), rig=rig)

    # The z mount of a new campaign is that of the thesis.
    assert cfid.swing.fit(within).quantities == given.quantities
    assert np.isfinite(given.quantities["swing.axis_inertia_kg_m2"].value)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"mass_kg": 0.03}, "a mass alone"),
        ({"distance_m": 0.02}, "a distance alone"),
        ({"mass_kg": 0.03, "distance_m": -0.02}, "distance_m"),
        ({"mass_kg": 0.0, "distance_m": 0.02}, "mass_kg"),
        ({"gravity_mps2": -9.81}, "gravity_mps2"),
        ({"peaks": 3}, "4 peaks"),
        ({"peaks": {"y": 8}}, "no swing is about"),
        ({"axis": "w", "rig": thesis_rig()}, "no mount"),
    ],
)
def test_arguments_that_contradict_each_other_are_refused_by_their_names(
    record: AngleRecord, arguments: dict[str, object], reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        cfid.swing.fit(record, **arguments)  # type: ignore[arg-type]


def test_a_swing_of_another_body_has_a_section_of_its_own(record: AngleRecord) -> None:
    bodies = [record, replace(record, label=Label(body="testbody")), replace(record, label=Label(body="fixture"))]
    sections = [cfid.swing.fit(body, axis="z", mass_kg=0.03, distance_m=0.02).section for body in bodies]

    assert sections == ["swing z", "swing testbody z", "swing fixture z"]
