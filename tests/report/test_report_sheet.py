"""The sheet has every parameter of appendix A with std, interval and origin, and names missing parameters."""

from dataclasses import replace
from pathlib import Path

import pytest

from cfid.records.campaign import Campaign
from cfid.records.parameters import Source
from cfid.report.formats.grids import origin_text, row_grid
from cfid.report.formats.html import as_html
from cfid.report.formats.markdown import as_markdown
from cfid.report.sheet import SheetEntry
from tests.lab import keep
from tests.report.fits_by_hand import APPENDIX_A, new_campaign, number, put, put_appendix_a, report_of


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return new_campaign(tmp_path)


def quantities(campaign: Campaign) -> list[SheetEntry]:
    return [quantity for group in report_of(campaign).sheet for quantity in group.quantities]


def quantity(campaign: Campaign, key: str) -> SheetEntry:
    return next(one for one in quantities(campaign) if key in one.keys)


def test_every_number_of_appendix_a_stands_on_the_sheet(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    shown = {(row.value, row.std) for one in quantities(campaign) for row in one.rows}

    for parameters in APPENDIX_A.values():
        for parameter in parameters.values():
            values = parameter.value if isinstance(parameter.value, list) else [parameter.value]
            flat = [x for value in values for x in (value if isinstance(value, list) else [value])]
            assert {value for value, _ in shown} >= set(flat) - {1.0}
    assert (0.0280, 3e-5) in shown


def test_an_interval_is_1_96_deviations_to_either_side(campaign: Campaign) -> None:
    put(campaign, "speed", {"motor.speed_poly": number([0.0400, 400.0], "rad/s(cmd)", [0.0002, 10.0])})
    rows = row_grid(quantity(campaign, "motor.speed_poly").rows).rows

    assert rows == (
        ("b_1", "40.00", "0.20", "39.61 to 40.39", "10⁻³ rad/s/cmd"),
        ("b_0", "400", "10", "380 to 420", "rad/s"),
    )


def test_what_is_missing_is_named_with_the_command_that_gives_it(campaign: Campaign) -> None:
    missing = {key: one.missing for one in quantities(campaign) if not one.rows for key in one.keys}

    assert "cfid fit inertia" in missing["inertia.matrix_kg_m2"]
    assert "cfid log thrust" in missing["motor.thrust_poly"]
    assert "cfid tf identify" in missing["tf.numerator"]
    assert "cfid fit drag" in missing["drag.complex.k3"]
    assert "vehicle.mass_kg" not in missing


def test_of_a_fit_that_found_part_of_it_the_rest_is_named(campaign: Campaign) -> None:
    put(campaign, "tf", {"tf.numerator": number([7.2e-8], "N")})

    assert "tf.denominator" in quantity(campaign, "tf.numerator").missing


def test_it_says_how_and_from_how_many_recordings_a_quantity_was_found(campaign: Campaign) -> None:
    put(campaign, "inertia", APPENDIX_A["inertia"], sources=["a", "b", "c"], method="thesis")
    origin = quantity(campaign, "inertia.matrix_kg_m2").origin

    assert origin is not None
    assert origin_text(origin) == "cfid fit inertia, method thesis, from 3 recordings, 2026-11-21 12:00 UTC"
    assert origin.accepted


def test_files_of_one_run_are_one_recording(campaign: Campaign) -> None:
    fit = put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a", "a"])
    origin = quantity(campaign, "motor.thrust_poly").origin

    assert len(fit.section.sources) == 2
    assert origin is not None
    assert origin.recordings == 1


def test_files_beside_the_runs_are_counted_as_files(campaign: Campaign) -> None:
    fit = put(campaign, "speed", APPENDIX_A["speed"], sources=["a"])
    keep(
        campaign.folder,
        "speed",
        replace(fit.section, sources=(*fit.section.sources, Source("speeds.csv", "0" * 64))),
    )
    origin = quantity(campaign, "motor.speed_poly").origin

    assert origin is not None
    assert "from one recording and one file" in origin_text(origin)


def test_a_model_that_a_fit_could_not_find_is_not_said_to_be_unmeasured(campaign: Campaign) -> None:
    put(campaign, "drag", {"drag.simple_kg_per_rad": APPENDIX_A["drag"]["drag.simple_kg_per_rad"]})

    assert quantity(campaign, "drag.complex.k1").missing.startswith("the last `cfid fit drag` did not find it")


def test_what_was_rejected_says_so_with_the_reason(campaign: Campaign) -> None:
    put(campaign, "torque", APPENDIX_A["torque"], rejected="the line leaves too much.")
    origin = quantity(campaign, "motor.torque_poly").origin

    assert origin is not None
    assert origin.accepted is False
    assert origin.findings == ("the line leaves too much.",)


def test_the_mass_is_stated_and_neither_accepted_nor_rejected(campaign: Campaign) -> None:
    origin = quantity(campaign, "vehicle.mass_kg").origin

    assert origin is not None
    assert origin.accepted is None


def test_what_the_form_of_a_transfer_function_fixes_is_no_parameter(campaign: Campaign) -> None:
    parameters = {
        "tf.numerator": number([0.0, 7.3e-8], "N", [0.0, 4e-10]),
        "tf.denominator": number([1.0, -0.97], "1", [0.0, 1e-4]),
    }
    put(campaign, "tf", parameters)

    assert [row.symbol for row in quantity(campaign, "tf.numerator").rows] == ["n_1", "d_1"]


def test_a_polynomial_of_any_order_names_its_powers_and_their_units(campaign: Campaign) -> None:
    put(campaign, "thrust", {"motor.thrust_poly": number([1e-16, 2e-11, 1e-6, 5e-4], "N(cmd)")})
    rows = quantity(campaign, "motor.thrust_poly").rows

    assert [(row.symbol, row.unit) for row in rows] == [
        ("a_3", "N/cmd^3"),
        ("a_2", "N/cmd^2"),
        ("a_1", "N/cmd"),
        ("a_0", "N"),
    ]


def test_what_was_measured_by_hand_has_a_group_of_its_own(campaign: Campaign) -> None:
    put(campaign, "set", {"arm_m": number(0.046, "m", 0.0002)}, method="by hand")
    group = report_of(campaign).sheet[-1]

    assert group.title == "Measured by hand"
    assert group.quantities[0].rows[0].value == 0.046


def test_numbers_of_one_quantity_share_a_power_of_ten_unless_one_would_vanish(campaign: Campaign) -> None:
    put(campaign, "inertia", APPENDIX_A["inertia"])
    units = {row[-1] for row in row_grid(quantity(campaign, "inertia.matrix_kg_m2").rows).rows}
    assert units == {"10⁻⁶ kg m²"}

    poly = number([3.0e-11, 6.0e-7, 2.0e-3], "N(cmd)")
    put(campaign, "thrust", {"motor.thrust_poly": poly})
    experiment = next(one for one in report_of(campaign).experiments if one.name == "thrust")
    assert [row[1] for row in row_grid(experiment.parameters).rows] == ["30.00", "600.0", "2.000"]


def test_a_value_that_is_known_to_many_digits_is_printed_with_them(campaign: Campaign) -> None:
    put(campaign, "latency", {"latency.clock_offset_s": number(1795287566.25, "s", 0.0012)})
    (experiment,) = report_of(campaign).experiments

    assert row_grid(experiment.parameters).rows[0][1:3] == ("1795287566.2500", "0.0012")


def test_terms_of_a_complex_model_that_are_consistent_with_zero_are_named(campaign: Campaign) -> None:
    terms = {f"drag.complex.k{i}": number([-9e-7, 1e-9, 2e-9], "", [4e-8, 1e-9, 2e-9]) for i in (1, 2)}
    noise = {f"drag.complex.k{i}": number([1e-9, -1e-9, 2e-9], "", [1e-9, 1e-9, 2e-9]) for i in (3, 4, 5, 6)}
    put(campaign, "drag", {**terms, **noise})
    words = "Consistent with zero, within 2 standard uncertainties: K1_y, K1_z, K2_y, K2_z, K3, K4, K5, K6."

    assert quantity(campaign, "drag.complex.k1").zeros == words
    assert words in as_html(report_of(campaign), campaign.folder)
    assert words in as_markdown(report_of(campaign)).replace("\\", "")


def test_a_number_that_is_clearly_there_or_alone_is_not_said_to_be_zero(campaign: Campaign) -> None:
    put(campaign, "speed", {"motor.speed_poly": number([0.0400, 400.0], "rad/s(cmd)", [0.0002, 10.0])})

    assert quantity(campaign, "motor.speed_poly").zeros == ""
    assert quantity(campaign, "vehicle.mass_kg").zeros == ""
