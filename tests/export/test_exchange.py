"""The JSON export has all measured values with uncertainties, and the values that rig.toml states."""

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np

from cfid.export.vehicle import collect
from cfid.records.covariances import names_of
from cfid.records.parameters import Parameter
from cfid.records.rig_file import thesis_rig
from tests.export.reading import export
from tests.export.thesis_vehicle import INERTIA_KG_M2, sections
from tests.lab import values_of


def test_what_rig_toml_states_has_its_uncertainty_and_its_axes() -> None:
    rig = thesis_rig()
    own = rig.vehicle.model_copy(update={"centre_of_mass_mm": (1.0, -2.0, 17.4), "centre_of_mass_std_mm": (0.5,) * 3})
    site = rig.site.model_copy(update={"gravity_mps2": 9.812, "gravity_std_mps2": 0.002})
    found = json.loads(
        export("json", collect(rig.model_copy(update={"vehicle": own, "site": site}), values_of(sections())))
    )

    centre, gravity = (found["quantities"][key] for key in ("centre_of_mass_m", "gravity_mps2"))
    assert (gravity["value"], gravity["std"]) == (9.812, 0.002)
    np.testing.assert_allclose([centre["value"], centre["std"]], [[0.001, -0.002, 0.0174], [5e-4] * 3])
    assert centre["frame"] == "campaign"


def test_both_fits_of_a_key_are_there() -> None:
    rows = {name: [{"cmd": command, "thrust_n": 0.1}] for name, command in (("thrust", 20000.0), ("torque", 30000.0))}
    known = sections()
    for name, row in rows.items():
        known[name] = replace(known[name], parameters={**known[name].parameters, "motor.table": Parameter(value=row)})
    found = json.loads(export("json", collect(thesis_rig(), values_of(known))))

    assert found["quantities"]["motor.table"]["value"] == rows["torque"]
    assert found["further"] == {"thrust": {"motor.table": found["further"]["thrust"]["motor.table"]}}
    assert found["further"]["thrust"]["motor.table"]["value"] == rows["thrust"]
    assert found["further"]["thrust"]["motor.table"]["origin"].startswith("section thrust;")


def test_the_schema_states_the_order_of_the_inertias_entries() -> None:
    names = names_of("inertia.matrix_kg_m2", INERTIA_KG_M2)

    assert ", ".join(name[-2:] for name in names) in files("cfid.export").joinpath("vehicle.schema.json").read_text()
