"""Results of `cfid.swing.fit` in a notebook: frequency, inertia and torques, each with its standard uncertainty."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cfid.swing
from cfid.errors import ConfigError
from cfid.recordings.angle import AngleRecord, labelled
from cfid.records.files import RIG_FILE
from cfid.records.parameters import Source
from cfid.records.rig_file import new_rig_text, thesis_rig
from cfid.records.run import Label
from tests.drawn import swing_record

# The pendulum of tests.drawn: W, and damping per inertia.
FREQUENCY, VISCOUS, COULOMB = 150.0, 0.6, 0.3


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> AngleRecord:
    time_s, angle_rad = swing_record()
    path = tmp_path_factory.mktemp("alone") / "encoder.csv"
    return AngleRecord(
        path=path, source=Source(str(path), "0" * 64), label=Label(), time_s=time_s, angle_rad=angle_rad, findings=()
    )


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


def test_an_inertias_uncertainty_is_that_of_frequency_mass_and_gravity_together(record: AngleRecord) -> None:
    result = cfid.swing.fit(record, mass_kg=0.03, distance_m=0.02)
    frequency, inertia = (
        result.quantities[f"swing.{key}"] for key in ("natural_frequency_squared_s2", "axis_inertia_kg_m2")
    )
    gravity = thesis_rig().site
    expected = math.hypot(frequency.std / frequency.value, gravity.gravity_std_mps2 / gravity.gravity_mps2)
    viscous = result.quantities["swing.viscous_nms_per_rad"]

    assert inertia.std / inertia.value == pytest.approx(expected, rel=1e-3)
    assert viscous.std / viscous.value > inertia.std / inertia.value


def test_a_swing_of_another_body_has_a_section_of_its_own(record: AngleRecord) -> None:
    bodies = [record, replace(record, label=Label(body="testbody")), replace(record, label=Label(body="fixture"))]
    sections = [cfid.swing.fit(body, axis="z", mass_kg=0.03, distance_m=0.02).section for body in bodies]

    assert sections == ["swing z", "swing testbody z", "swing fixture z"]


def test_without_mass_and_distance_there_is_a_frequency_alone(record: AngleRecord) -> None:
    result = cfid.swing.fit(record, axis="x", peaks=6)

    assert "swing.axis_inertia_kg_m2" not in result.quantities
    assert result.quantities["swing.peaks_used"].value == 6


def test_the_rig_is_that_of_the_campaign_that_the_recording_lies_in(record: AngleRecord, tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    (tmp_path / "runs").mkdir()
    within = labelled(AngleRecord(**{**vars(record), "path": tmp_path / "runs" / "encoder.csv"}), axis="z")
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
