"""The sheet has every parameter of appendix A with uncertainty, interval and origin, and names missing parameters."""

from dataclasses import replace
from typing import Any

from cfid.records.campaign import Campaign
from cfid.records.parameters import Source
from cfid.report.render import rendered
from cfid.report.texts import number_grid, origin_text
from tests.lab import keep
from tests.report.fits_by_hand import APPENDIX_A, number, put, put_appendix_a, report_of


def entries(campaign: Campaign) -> list[dict[str, Any]]:
    return [entry for group in report_of(campaign)["sheet"] for entry in group["quantities"]]


def entry(campaign: Campaign, key: str) -> dict[str, Any]:
    return next(each for each in entries(campaign) if key in each["keys"])


def test_every_number_of_appendix_a_stands_on_the_sheet(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    rows = {(row["value"], row["std"]) for each in entries(campaign) for row in each["rows"]}

    for parameters in APPENDIX_A.values():
        for key, parameter in parameters.items():
            numbers = {(number.value, number.std) for number in parameter.numbers(key)}
            assert rows >= numbers - {(1.0, 0.0)}
    assert (0.0280, 3e-5) in rows


def test_an_interval_is_1_96_standard_uncertainties_to_either_side(campaign: Campaign) -> None:
    put(campaign, "speed", {"motor.speed_poly": number([0.0400, 400.0], "rad/s(cmd)", [0.0002, 10.0])})

    assert number_grid(entry(campaign, "motor.speed_poly")["rows"]).rows == [
        ("b_1", "40.00", "0.20", "39.61 to 40.39", "10⁻³ rad/s/cmd"),
        ("b_0", "400", "10", "380 to 420", "rad/s"),
    ]
    assert entry(campaign, "motor.speed_poly")["zeros"] == ""


def test_missing_quantities_are_named_with_the_command_that_gives_them(campaign: Campaign) -> None:
    missing = {key: each["missing"] for each in entries(campaign) if not each["rows"] for key in each["keys"]}

    assert "cfid fit inertia" in missing["inertia.matrix_kg_m2"]
    assert "cfid log thrust" in missing["motor.thrust_poly"]
    assert "cfid tf identify" in missing["tf.numerator"]
    assert "cfid fit drag" in missing["drag.complex.k3"]
    assert "vehicle.mass_kg" not in missing

    put(campaign, "tf", {"tf.numerator": number([7.2e-8], "N")})
    put(campaign, "drag", {"drag.simple_kg_per_rad": APPENDIX_A["drag"]["drag.simple_kg_per_rad"]})
    assert "tf.denominator" in entry(campaign, "tf.numerator")["missing"]
    assert "not measured" not in entry(campaign, "drag.complex.k1")["missing"]


def test_the_origin_counts_recordings_and_files(campaign: Campaign) -> None:
    fit = put(campaign, "inertia", APPENDIX_A["inertia"], sources=["a", "a", "b", "c"], method="thesis")
    sources = (*fit.section.sources, Source("swing.csv", "0" * 64))
    keep(campaign.folder, "inertia", replace(fit.section, sources=sources))
    origin = entry(campaign, "inertia.matrix_kg_m2")["origin"]

    assert origin["accepted"] is True
    expected = "cfid fit inertia, method thesis, from 3 recordings and one file, 2026-11-21 12:00 UTC"
    assert origin_text(origin) == expected


def test_a_rejected_quantity_has_the_reason_and_stated_ones_no_verdict(campaign: Campaign) -> None:
    put(campaign, "torque", APPENDIX_A["torque"], rejected="the line leaves too much.")
    put(campaign, "set", {"arm_m": number(0.046, "m", 0.0002)}, method="by hand")
    origin, group = entry(campaign, "motor.torque_poly")["origin"], report_of(campaign)["sheet"][-1]

    assert (origin["accepted"], origin["findings"]) == (False, ["the line leaves too much."])
    assert entry(campaign, "vehicle.mass_kg")["origin"]["accepted"] is None
    assert (group["title"], group["quantities"][0]["rows"][0]["value"]) == ("Measured by hand", 0.046)


def test_numbers_that_the_form_of_a_transfer_function_fixes_are_left_out(campaign: Campaign) -> None:
    parameters = {
        "tf.numerator": number([0.0, 7.3e-8], "N", [0.0, 4e-10]),
        "tf.denominator": number([1.0, -0.97], "1", [0.0, 1e-4]),
    }
    put(campaign, "tf", parameters)

    assert [row["symbol"] for row in entry(campaign, "tf.numerator")["rows"]] == ["n_1", "d_1"]


def test_a_polynomial_of_any_order_names_its_powers_and_their_units(campaign: Campaign) -> None:
    put(campaign, "thrust", {"motor.thrust_poly": number([1e-16, 2e-11, 1e-6, 5e-4], "N(cmd)")})
    units = {row["symbol"]: row["unit"] for row in entry(campaign, "motor.thrust_poly")["rows"]}

    assert units == {"a_3": "N/cmd^3", "a_2": "N/cmd^2", "a_1": "N/cmd", "a_0": "N"}


def test_numbers_of_one_quantity_share_a_power_of_ten_unless_one_would_vanish(campaign: Campaign) -> None:
    put(campaign, "inertia", APPENDIX_A["inertia"])
    put(campaign, "thrust", {"motor.thrust_poly": number([3.0e-11, 6.0e-7, 2.0e-3], "N(cmd)")})
    put(campaign, "latency", {"latency.clock_offset_s": number(1795287566.25, "s", 0.0012)})
    printed = {each["name"]: number_grid(each["parameters"]).rows for each in report_of(campaign)["experiments"]}

    assert {row[-1] for row in printed["inertia"]} == {"10⁻⁶ kg m²"}
    assert [row[1] for row in printed["thrust"]] == ["30.00", "600.0", "2.000"]
    assert printed["latency"][0][1:3] == ("1795287566.2500", "0.0012")


def test_terms_of_a_complex_model_that_are_consistent_with_zero_are_named(campaign: Campaign) -> None:
    terms = {f"drag.complex.k{i}": number([-9e-7, 1e-9, 2e-9], "", [4e-8, 1e-9, 2e-9]) for i in (1, 2)}
    noise = {f"drag.complex.k{i}": number([1e-9, -1e-9, 2e-9], "", [1e-9, 1e-9, 2e-9]) for i in (3, 4, 5, 6)}
    put(campaign, "drag", {**terms, **noise})
    names = "K1_y, K1_z, K2_y, K2_z, K3, K4, K5, K6"

    assert entry(campaign, "drag.complex.k1")["zeros"].partition(": ")[2] == f"{names}."
    for form in ("html", "md", "tex"):
        assert names in rendered(report_of(campaign), form, campaign.folder).replace("\\", "")


def test_of_the_models_of_drag_only_the_chosen_one_is_listed(campaign: Campaign) -> None:
    models = APPENDIX_A["drag"]
    for chosen, listed in (("simple", ["drag.simple_kg_per_rad"]), ("cross", ["drag.cross_coupling_kg_per_rad"])):
        put(campaign, "drag", models, quality={"chosen": chosen})
        assert [key for each in entries(campaign) for key in each["keys"] if key.startswith("drag.")] == listed
