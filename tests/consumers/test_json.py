"""The JSON export matches its schema according to jsonschema; a reader needs nothing else."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cfid.export.vehicle import collect
from cfid.export.vehicle_json import VehicleFile
from cfid.records.rig_file import thesis_rig
from tests.consumers.plant import DRAG_KG_PER_RAD, INERTIA, PLACES, measured
from tests.export.reading import export
from tests.export.thesis_vehicle import section, sections, vehicle
from tests.lab import values_of

SCHEMA = VehicleFile.model_json_schema()


def judged(text: str) -> dict[str, Any]:
    """Validate a file against the schema, and return its content."""
    import jsonschema

    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    found: dict[str, Any] = json.loads(text)
    jsonschema.Draft202012Validator(SCHEMA).validate(found)
    return found


def test_the_file_is_as_its_schema_says_and_turned_to_the_vehicles_frame() -> None:
    found = judged(export("json", measured()))

    matrix = found["quantities"]["inertia.matrix_kg_m2"]
    turn = np.array(found["frames"]["campaign_to_vehicle"])
    np.testing.assert_allclose(matrix["in_vehicle_frame"]["value"], INERTIA, rtol=1e-9)
    np.testing.assert_allclose(turn @ matrix["value"] @ turn.T, INERTIA, rtol=1e-9)
    drag = found["quantities"]["drag.simple_kg_per_rad"]
    np.testing.assert_allclose(drag["in_vehicle_frame"]["value"], -DRAG_KG_PER_RAD)
    np.testing.assert_allclose([rotor["place_m"][:2] for rotor in found["rotors"]], PLACES, atol=1e-12)


@pytest.mark.parametrize("without", ["arm_m", "inertia.matrix_kg_m2", "motor.thrust_poly", "dynamics.rising"])
def test_a_vehicle_that_was_measured_in_part_fits_the_schema(without: str) -> None:
    assert without not in judged(export("json", vehicle(without)))["quantities"]


def test_covariances_are_handed_on_as_they_are() -> None:
    blocks = {"covariance": [{"of": ["a", "b"], "matrix": [[1.0, 0.5], [0.5, 2.0]]}], "common": {"arm_m": {"a": [0.1]}}}
    known = replace(measured(), covariance={"thrust": blocks})
    assert judged(export("json", known))["covariance"] == {"thrust": blocks}


def test_both_fits_of_a_key_fit_the_schema() -> None:
    known = sections()
    known["speed"] = replace(known["speed"], parameters={**known["speed"].parameters, **known["thrust"].parameters})

    assert set(judged(export("json", collect(thesis_rig(), values_of(known))))["further"]) == {"thrust"}


@pytest.mark.parametrize(
    ("block", "broken"),
    [
        ("covariance", {"thrust": {"covariance": [{"of": ["a"]}]}}),
        ("covariance", {"thrust": {"covariance": {"of": ["a"], "matrix": [[1.0]]}}}),
        ("covariance", {"thrust": {"common": {"arm": [0.1]}}}),
        ("quantities", {"mass_kg": {"value": "28 g"}}),
        ("quantities", {"mass_kg": {"std": True}}),
        ("quantities", {"mass_kg": {"std": [{"mass_kg": 1.0}]}}),
    ],
)
def test_what_is_of_another_form_is_refused_by_the_schema(block: str, broken: dict[str, Any]) -> None:
    import jsonschema

    found = json.loads(export("json", measured()))
    for key, entry in broken.items():
        found[block][key] = {**found[block].get(key, {}), **entry}

    with pytest.raises(jsonschema.ValidationError):
        judged(json.dumps(found))


def test_tables_with_words_and_truths_fit_the_schema() -> None:
    row = {"series": "motor1", "cmd": 20000, "std_n": None, "accepted": True}
    known = {**sections(), "rows": section({"tf.frequency_response": [row]})}

    found = judged(export("json", collect(thesis_rig(), values_of(known))))["quantities"]
    assert found["tf.frequency_response"]["value"] == [row]
