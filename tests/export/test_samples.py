"""`cfid export samples` draws possible vehicles with the stated covariances, and every file has the same numbers."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.export.samples import Joint, impossible, joint_of
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section
from tests.export.thesis_vehicle import INERTIA_KG_M2, flown_sections, section, sections
from tests.lab import Cfid, keep, keep_instead, made_run, new_campaign

Array = npt.NDArray[np.float64]

COUNT = 40_000
STD = {  # standard uncertainties, in the unit of each number
    "motor.thrust_poly": [5e-13, 3e-8, 3e-4],
    "motor.speed_poly": [2e-4, 5.0],
    "motor.torque_poly": [3e-5, 2e-6],
    "motor.thrust_voltage_poly": [5e-5, 2e-4, 1e-4, 3e-5],
    "motor.thrust_per_speed_squared_n_s2": 2e-10,
    "motor.thrust_speed_poly": [2e-10, 0.0, 0.0],
    "dynamics.rising": [0.2, 1e-4],
    "dynamics.falling": [0.1, 5e-5],
    "drag.simple_kg_per_rad": [2e-8, 2e-8, 3e-8],
    "tf.time_constant_s": 1e-3,
}
POSSIBLE: dict[str, Any] = {
    "mass_kg": 0.028,
    "inertia.matrix_kg_m2": INERTIA_KG_M2,
    "motor.thrust_poly": [2.130295e-11, 1.032633e-6, 5.484560e-4],
    "motor.speed_poly": [0.04076521, 380.8359],
    "motor.torque_poly": [0.005964552, 1.563383e-5],
    "motor.max_thrust_n": 0.16,
    "motor.thrust_per_speed_squared_n_s2": 1.9e-8,
    "motor.thrust_speed_poly": [1.9e-8, 0.0, 0.0],
    "motor.thrust_voltage_poly": [-0.0148, 0.0472, -0.0185, 0.00596],
    "dynamics.rising": [7.0, 0.002],
    "dynamics.falling": [3.0, 0.001],
    "tf.time_constant_s": 0.06,
}


# The joint distribution


def random_covariance(seed: int, size: Sequence[float]) -> Array:
    factor = np.random.default_rng(seed).standard_normal((len(size), len(size)))
    covariance = factor @ factor.T
    unit = np.array(size) / np.sqrt(np.diag(covariance))
    return np.asarray(covariance * np.outer(unit, unit))


def fit_of(
    parameters: Mapping[str, tuple[Any, Any]],
    *,
    covariance: Array | None = None,
    common: Mapping[str, Mapping[str, list[float]]] | None = None,
) -> Section:
    """Return a fit of parameters with values and standard uncertainties, and their covariance."""
    values = {key: value for key, (value, _) in parameters.items()}
    return replace(
        section({key: Parameter(value=value, std=std) for key, (value, std) in parameters.items()}),
        covariance=() if covariance is None else covariance_between(values, covariance),
        common=common or {},
    )


def assert_drawn_as_stated(joint: Joint) -> None:
    """Compare the mean and covariance of many draws with the stated ones, in units of their sampling errors."""
    draws = joint.draw(COUNT, np.random.default_rng(5))
    std = np.sqrt(np.diag(joint.covariance))
    free = std > 0
    assert np.array_equal(draws[:, ~free], np.broadcast_to(joint.mean[~free], (COUNT, int(np.sum(~free)))))
    scaled = (draws - joint.mean)[:, free] / std[free]
    stated = joint.covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
    assert np.max(np.abs(scaled.mean(axis=0))) * np.sqrt(COUNT) < 3.5
    assert np.max(np.abs(scaled.T @ scaled / COUNT - stated) / np.sqrt((1 + stated**2) / COUNT)) < 3.5


def test_mean_and_covariance_of_draws_are_the_stated_ones() -> None:
    poly = random_covariance(1, [5e-13, 4e-8, 6e-4, 3e-4])
    inertia = random_covariance(2, [1e-8, 2e-8, 3e-8, 1e-8, 2e-8, 1e-8])
    std = np.sqrt(np.diag(poly))
    thrust = {"motor.thrust_poly": ([2e-11, 1e-6, 5e-4], std[:3].tolist()), "motor.max_thrust_n": (0.15, std[3])}
    joint = joint_of(
        [
            (fit_of(thrust, covariance=poly), list(thrust)),
            (fit_of({"inertia.matrix_kg_m2": (INERTIA_KG_M2, None)}, covariance=inertia), ["inertia.matrix_kg_m2"]),
            (fit_of({"arm_m": (0.046, 1e-4), "rotor_radius_m": (0.0231, None)}), ["arm_m", "rotor_radius_m"]),
            (fit_of({"motor.torque_poly": ([6e-3, 1e-5], [1e-5, 1e-6])}), ["motor.torque_poly"]),
        ]
    )

    assert joint.covariance[:4, :4] == pytest.approx(poly)
    assert joint.covariance[4:10, 4:10] == pytest.approx(inertia)
    assert joint.covariance[12:, 12:] == pytest.approx(np.diag([1e-10, 1e-12]))
    assert (joint.exact, joint.independent) == (("rotor_radius_m",), ("motor.torque_poly",))
    assert joint.names[4:10] == tuple(f"inertia.matrix_kg_m2 {entry}" for entry in ("xx", "yy", "zz", "xy", "xz", "yz"))
    assert joint.shaped(joint.mean) == dict(joint.values)
    assert_drawn_as_stated(joint)


def test_fits_that_share_a_tachometer_or_an_arm_covary_by_what_it_does_to_both() -> None:
    square, lag = "motor.thrust_per_speed_squared_n_s2", "tf.static_gain_n"
    fits = {
        "motor.speed_poly": fit_of(
            {"motor.speed_poly": ([0.041, 380.0], [4e-4, 5.0])},
            covariance=np.array([[16e-8, 1e-3], [1e-3, 25.0]]),
            common={"tachometer": {"motor.speed_poly": [3e-4, 3.0]}},
        ),
        square: fit_of({square: (2e-8, 4e-10)}, common={"tachometer": {square: [-3e-10]}, "arm": {}}),
        lag: fit_of({lag: (2.2e-6, 3e-8)}, common={"arm": {lag: [-2e-8]}}),
        "arm_m": fit_of({"arm_m": (0.046, 1e-4)}, common={"arm": {"arm_m": [1e-4]}}),
    }
    joint = joint_of([(fit, [key]) for key, fit in fits.items()])

    assert joint.covariance[:2, 2] == pytest.approx([3e-4 * -3e-10, 3.0 * -3e-10])
    assert joint.covariance[3, 4] == pytest.approx(-2e-8 * 1e-4)
    assert np.diag(joint.covariance) == pytest.approx(np.square([4e-4, 5.0, 4e-10, 3e-8, 1e-4]))
    assert joint.covariance[0, 4] == 0.0
    assert_drawn_as_stated(joint)


def test_of_a_covariance_with_more_in_it_the_part_that_is_wanted_is_taken() -> None:
    whole = random_covariance(3, [1.0, 2.0, 3.0])
    fit = fit_of({"tf.denominator": ([1.0, -0.97], None), "tf.time_constant_s": (0.06, 3.0)}, covariance=whole)

    assert joint_of([(fit, ["tf.time_constant_s"])]).covariance == pytest.approx(whole[2:, 2:])


@pytest.mark.parametrize(
    "fits",
    [
        [fit_of({name: (1.0, 0.1)}, common={"arm": {name: [0.3]}}) for name in ("a_m", "b_m")],
        [fit_of({"motor.torque_poly": ([6e-3, 1e-5], [1e-5, 1e-6])}, covariance=np.diag([4e-10, 1e-12]))],
    ],
    ids=["causes beyond the std", "a diagonal beyond the std"],
)
def test_uncertainties_that_contradict_each_other_are_refused(fits: Sequence[Section]) -> None:
    with pytest.raises(DataError):
        joint_of([(fit, list(fit.parameters)) for fit in fits]).draw(1, np.random.default_rng(1))


# Possible vehicles


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mass_kg", -0.001),
        ("tf.time_constant_s", 0.0),
        ("motor.max_thrust_n", -0.1),
        ("inertia.matrix_kg_m2", [[16e-6, 0, 0], [0, -1e-6, 0], [0, 0, 16e-6]]),  # not positive
        ("inertia.matrix_kg_m2", [[16e-6, 0, 0], [0, 16e-6, 0], [0, 0, 33e-6]]),  # triangle inequality
        ("motor.thrust_poly", [-2.1e-11, 1.0e-6, 0.0]),  # falls from command 24000 on
        ("motor.speed_poly", [-0.04, 3000.0]),
        ("motor.torque_poly", [-0.006, 0.001]),
        ("motor.thrust_speed_poly", [-1e-8, 2e-5, 0.0]),
        ("motor.thrust_voltage_poly", [0.0, 0.0, 0.02, -0.0035]),  # falls from 3.8 V on
        ("motor.thrust_voltage_poly", [0.0, 0.01, 0.012, 0.002]),  # is flat at -2 V alone: c2^2 > 3 c1 c3
        ("dynamics.rising", [-20.0, 0.002]),
        ("dynamics.falling", [1.0, -0.001]),
    ],
)
def test_each_way_of_being_no_vehicle_is_named(key: str, value: Any) -> None:
    assert impossible(POSSIBLE) == ""
    assert impossible({**POSSIBLE, key: value}).startswith(key)


def test_a_map_is_judged_over_what_was_measured_and_reached() -> None:
    falls_early = {**POSSIBLE, "motor.thrust_poly": [2.1e-11, -2e-7, 0.001]}  # falls up to command 4762
    falls_late = {**POSSIBLE, "motor.torque_poly": [-0.015, 0.005, 0.0]}  # from 0.167 N on
    reached = {key: value for key, value in falls_late.items() if key != "motor.thrust_poly"} | {
        "motor.max_thrust_n": 0.2
    }

    assert impossible(falls_early, commands=(1000, 65535)) == "motor.thrust_poly does not rise"
    assert impossible(falls_early, commands=(6000, 65535)) == impossible(falls_late) == ""
    assert impossible(reached) == "motor.torque_poly does not rise"


# Files


def uncertain(fit: Section, std: Mapping[str, Any] = STD) -> Section:
    """Return a section whose parameters have standard uncertainties, and the inertia a covariance."""
    parameters = {key: replace(found, std=std.get(key, found.std)) for key, found in fit.parameters.items()}
    if "inertia.matrix_kg_m2" not in parameters:
        return replace(fit, parameters=parameters)
    parameters["inertia.matrix_kg_m2"] = Parameter(value=INERTIA_KG_M2, std=[[1e-8] * 3] * 3, unit="kg m^2")
    covariance = 1e-16 * (0.5 * np.eye(6) + 0.5 * np.ones((6, 6)))
    block = covariance_between({"inertia.matrix_kg_m2": INERTIA_KG_M2}, covariance)
    return replace(fit, parameters=parameters, covariance=block)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with the thesis' numbers and with uncertainties, in the folder where `cfid` runs."""
    new_campaign(tmp_path)
    for name, fit in sections().items():
        keep(tmp_path, name, uncertain(fit))
    return tmp_path


def read_csv(path: Path) -> tuple[list[str], Array]:
    head, *rows = csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    return head, np.array(rows, dtype=np.float64)


def worlds_of(folder: Path) -> list[dict[str, Any]]:
    """Return the parameters of each of crazyflow's worlds, which have axes for drones and motors."""
    with np.load(folder / "samples_crazyflow.npz") as file:
        arrays = dict(file)
    return [{name: values[world, 0] for name, values in arrays.items()} for world in range(len(arrays["mass"]))]


def test_all_files_hold_the_same_vehicles_as_their_own_exports_write_them(cfid: Cfid, campaign: Path) -> None:
    ended = cfid("export", "samples", "--n", "20", "--seed", "7", "--out", "drawn")
    assert ended.returncode == 0, ended.stderr
    folder = campaign / "drawn"
    head, rows = read_csv(folder / "samples.csv")
    with np.load(folder / "samples.npz") as file:
        packed = dict(file)
    drones = worlds_of(folder)
    names: dict[str, Any] = {}
    exec((folder / "samples_rotorpy.py").read_text(), names)

    assert packed["names"].tolist() == head
    assert np.array_equal(packed["values"], rows)
    assert packed["covariance"].shape == (len(head), len(head))
    assert (len(drones), len(names["QUADS"]), len(rows)) == (20, 20, 20)
    for row, drone, quad in zip(rows, drones, names["QUADS"], strict=True):
        number = dict(zip(head, row, strict=True))
        assert drone["mass"] == pytest.approx(quad["mass"], rel=1e-6)  # in single precision
        assert quad["mass"] == pytest.approx(number["mass_kg"])
        assert quad["k_eta"] == pytest.approx(number["motor.thrust_per_speed_squared_n_s2"])
        # The thesis' x axis points to the right, so its yy is the moment about the axis that points forward.
        assert quad["Ixx"] == pytest.approx(number["inertia.matrix_kg_m2 yy"])
        assert drone["J"][0][0] == pytest.approx(quad["Ixx"], rel=1e-6)
        np.testing.assert_allclose(drone["J"] @ drone["J_inv"], np.eye(3), atol=1e-6)
        assert quad["rotor_pos"]["r1"][0] == pytest.approx(
            number["arm_m"] / np.sqrt(2) - number["centre_of_mass_m [1]"]
        )
    assert len({float(drone["mass"][0]) for drone in drones}) == 20


def test_moments_of_flights_are_drawn_as_flights_show_them(cfid: Cfid, tmp_path: Path) -> None:
    new_campaign(tmp_path)
    for name, fit in flown_sections().items():
        keep(tmp_path, name, uncertain(fit))
    ended = cfid("export", "samples", "--n", "20", "--out", "drawn")
    assert ended.returncode == 0, ended.stderr
    head, rows = read_csv(tmp_path / "drawn" / "samples.csv")
    drones = worlds_of(tmp_path / "drawn")

    for row, drone in zip(rows, drones, strict=True):
        number = dict(zip(head, row, strict=True))
        assert np.diag(drone["J"]) == pytest.approx(
            [number[f"flight.inertia_kg_m2.{axis}"] for axis in ("roll", "pitch", "yaw")], rel=1e-6
        )
        assert drone["drag_matrix"][1][1] == pytest.approx(number["flight.drag_kg_per_s.left"])
    assert len({drone["J"][0][0] for drone in drones}) == 20


def test_every_vehicle_that_is_delivered_is_possible_and_the_rejected_share_is_stated(
    cfid: Cfid, campaign: Path
) -> None:
    wide = {**STD, "motor.torque_poly": [4e-3, 2e-6]}  # wide enough that a few maps fall
    keep_instead(campaign, "torque", uncertain(sections()["torque"], wide))
    ended = cfid("export", "samples", "--n", "300", "--seed", "3")
    assert ended.returncode == 0, ended.stderr
    head, rows = read_csv(campaign / "exports" / "samples.csv")
    with np.load(campaign / "exports" / "samples.npz") as file:
        share = float(file["rejected_share"])

    printed = re.search(
        r"(\d+\.\d) % of (\d+) draws rejected: motor\.torque_poly does not rise \((\d+)\)", ended.stderr
    )
    assert printed is not None
    assert share == pytest.approx(int(printed[3]) / int(printed[2]), abs=0.01)
    assert 0.02 < share < 0.2
    assert len(rows) == 300
    assert (rows[:, head.index("motor.torque_poly [0]")] > 0).all()


def test_what_rig_toml_states_is_drawn_too(cfid: Cfid, campaign: Path) -> None:
    for path in (campaign / "fits").glob("*_set.json"):
        path.unlink()
    rig = campaign / "rig.toml"
    stated = {
        "centre_of_mass_std_mm": "[0.5, 0.4, 0.3]",
        "gravity_std_mps2": "0.002",
        "arm_std_mm": "0.4",
        "mass_std_kg": "2e-4",
    }
    text = rig.read_text()
    for key, value in stated.items():
        text = re.sub(rf"^{key} = .*\n", "", text, flags=re.MULTILINE)
        text = re.sub(
            rf"^{key.replace('_std', '')} = .*$", rf"\g<0>\n{key} = {value}", text, count=1, flags=re.MULTILINE
        )
    rig.write_text(text)
    causes = {"centre x": [0.6e-8, *[0.0] * 5], "gravity": [-0.5e-8, *[0.0] * 5]}
    common = {cause: {"inertia.matrix_kg_m2": moved} for cause, moved in causes.items()}
    block = covariance_between({"inertia.matrix_kg_m2": INERTIA_KG_M2}, 1e-16 * np.eye(6))
    keep_instead(campaign, "inertia", replace(uncertain(sections()["inertia"]), common=common, covariance=block))
    ended = cfid("export", "samples", "--n", "400", "--seed", "3")
    assert ended.returncode == 0, ended.stderr

    head, rows = read_csv(campaign / "exports" / "samples.csv")
    names = [*(f"centre_of_mass_m [{i}]" for i in range(3)), "gravity_mps2", "arm_m", "mass_kg"]
    spread = [rows[:, head.index(name)].std() for name in names]
    assert spread == pytest.approx([5e-4, 4e-4, 3e-4, 2e-3, 4e-4, 2e-4], rel=0.15)
    drones = worlds_of(campaign / "exports")
    assert len({float(drone["mixing_matrix"][0][0]) for drone in drones}) == 400
    # The inertia below moves by 0.6 of its standard uncertainty with the centre's x, and by -0.5 with gravity.
    with_xx = [
        np.corrcoef(rows[:, head.index("inertia.matrix_kg_m2 xx")], rows[:, head.index(name)])[0, 1]
        for name in names[:4]
    ]
    assert with_xx == pytest.approx([0.6, 0, 0, -0.5], abs=0.12)
    assert not re.search(
        r"no (uncertainty|covariance) is \w+ of [^:]*(centre|gravity|mass_kg)", " ".join(ended.stderr.split())
    )


def test_the_same_seed_draws_the_same_vehicles_and_nothing_is_overwritten(cfid: Cfid, campaign: Path) -> None:
    for seed, folder in (("1", "a"), ("1", "b"), ("2", "c")):
        assert cfid("export", "samples", "--n", "5", "--seed", seed, "--out", folder).returncode == 0
    tables = [(campaign / folder / "samples.csv").read_text() for folder in "abc"]
    assert tables[0] == tables[1] != tables[2]

    (campaign / "a" / "samples.npz").unlink()
    assert cfid("export", "samples", "--n", "6", "--out", "a").returncode == 2
    assert (campaign / "a" / "samples.csv").read_text() == tables[0]
    assert not (campaign / "a" / "samples.npz").exists()


def test_what_a_target_lacks_leaves_its_list_out(cfid: Cfid, tmp_path: Path) -> None:
    new_campaign(tmp_path)
    ended = cfid("export", "samples", "--n", "5")

    assert (ended.returncode, "crazyflow" in ended.stderr) == (0, True)
    assert sorted(path.name for path in (tmp_path / "exports").iterdir()) == ["samples.csv", "samples.npz"]


@pytest.mark.parametrize("itself", [False, True], ids=["wide uncertainties", "an impossible mean"])
def test_where_over_half_of_the_draws_are_no_vehicle_nothing_is_written(
    cfid: Cfid, campaign: Path, itself: bool
) -> None:
    body = [[16.6e-6, 0.0, 0.0], [0.0, 16.7e-6, 0.0], [0.0, 0.0, 9e-5]]
    if itself:
        keep_instead(campaign, "inertia", section({"inertia.matrix_kg_m2": body}))
    else:
        keep_instead(campaign, "torque", uncertain(sections()["torque"], {"motor.torque_poly": [0.1, 2e-6]}))
        keep_instead(campaign, "tf identify", section({"tf.time_constant_s": Parameter(value=0.06, std=0.5, unit="s")}))
    ended = cfid("export", "samples", "--n", "50", "--force")

    assert (ended.returncode, (campaign / "exports").exists()) == (4, False)
    words = " ".join(ended.stderr.split())
    assert ("inertia.matrix_kg_m2 is that of no possible body" in words) == itself
    assert ("motor.torque_poly does not rise (" in words) != itself


def test_every_file_is_marked_with_what_was_simulated_or_forced(cfid: Cfid, campaign: Path) -> None:
    run = made_run(campaign, "swing", {"encoder": {"t": [0.0], "phi": [0.0]}}, simulated=True)
    keep_instead(
        campaign,
        "inertia",
        replace(uncertain(section(sections()["inertia"].parameters, run=run.folder.name)), simulated=True),
    )
    torque = uncertain(sections()["torque"])
    keep_instead(campaign, "torque", replace(torque, accepted=False, rejected={"motor.torque_poly": "too little."}))
    assert cfid("set", "rotor_radius_m", "23.1", "--force").returncode == 0
    assert cfid("export", "samples", "--n", "5").returncode == 4
    ended = cfid("export", "samples", "--n", "5", "--force")
    assert ended.returncode == 0, ended.stderr

    folder = campaign / "exports"
    texts = {path.name: path.read_text() for path in folder.iterdir() if path.suffix != ".npz"}
    with np.load(folder / "samples.npz") as file:
        texts["samples.npz"] = " ".join(file["about"].tolist())
    texts["screen"] = " ".join(ended.stderr.split())
    for name, text in texts.items():
        for mark in (
            "SIMULATED: inertia.matrix_kg_m2:",
            "IMPLAUSIBLE: rotor_radius_m:",
            "REJECTED: motor.torque_poly:",
        ):
            assert mark in text, name
