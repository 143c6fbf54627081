"""Fits carry the rig's scale errors as causes that they share, and comparisons count each cause once."""

import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt
import pytest

from cfid.drag import fit as fit_drag
from cfid.drag.model import DragExperiments
from cfid.estimate.common_causes import arm_scales, power_law, with_common_causes
from cfid.motors.maps import fit_speed, fit_thrust, fit_torque
from cfid.motors.maps.data import Evidence
from cfid.motors.points import Points, frame
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section
from cfid.records.result import Result
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts, Scales, Tachometer, WindStand
from cfid.records.uncertain import OWN_FIT, measured, number_of, parts_of

Array = npt.NDArray[np.float64]

RIG = RigFacts(
    loadcell=LoadCellMount(
        yaw_deg=30.0,
        yaw_std_deg=1.0,
        arm_mm=46.0,
        arm_std_mm=0.46,
        gain_std=(0.01, 0.008, 0.006, 0.004, 0.005, 0.02),
        linearity_std=0.003,
        cross_talk_std=0.01,
        cross_talk_std_nm_per_n=2e-4,
    ),
    tachometer=Tachometer(scale_std=0.01),
    scales=Scales(linearity_std=0.001),
    wind=WindStand(azimuth_deg=28.0, azimuth_std_deg=1.5, speed_scale_std=0.02),
)
COMMAND = np.arange(5000.0, 65001.0, 5000.0)
THRUST = np.array([2.1e-11, 1e-6, 1e-3])  # as a polynomial of the command
SPEED = np.array([0.04, 350.0])
TORQUE_PER_THRUST = 0.006
NOISE_N, NOISE_NM, NOISE_RAD_S = 2e-4, 2e-6, 3.0


def points(rng: np.random.Generator, errors: Mapping[str, float] = {}) -> Points:
    """Return the readings of a motor by instruments whose scales are wrong by `errors`."""
    thrust, speed = np.polyval(THRUST, COMMAND), np.polyval(SPEED, COMMAND)
    bent = 1 + errors.get("linearity", 0.0)
    torque = TORQUE_PER_THRUST * thrust * bent * (1 + errors.get("Tz", 0.0)) + errors.get("talk", 0.0) * thrust
    count = len(COMMAND)
    return frame(
        COMMAND,
        thrust_n=thrust * bent * (1 + errors.get("Fz", 0.0)) + rng.normal(0, NOISE_N, count),
        torque_nm=torque + rng.normal(0, NOISE_NM, count),
        speed_rad_s=speed * (1 + errors.get("tachometer", 0.0)) + rng.normal(0, NOISE_RAD_S, count),
        thrust_std_n=np.full(count, NOISE_N),
        torque_std_nm=np.full(count, NOISE_NM),
        speed_std_rad_s=np.full(count, NOISE_RAD_S),
    )


def evidence(rng: np.random.Generator, errors: Mapping[str, float] = {}, rig: RigFacts = RIG) -> Evidence:
    return Evidence(points=points(rng, errors), loadcells=(rig,), tachometers=(rig,))


def drawn_errors(rng: np.random.Generator) -> dict[str, float]:
    stds = {"Fz": 0.006, "Tz": 0.02, "linearity": 0.003, "talk": 2e-4, "tachometer": 0.01}
    return {name: float(rng.normal(0, std)) for name, std in stds.items()}


# One fit


def test_a_thrust_map_goes_with_the_gain_of_fz_and_its_inverse_mass_does_too() -> None:
    result = fit_thrust(evidence(np.random.default_rng(1)), gravity_mps2=9.81)
    plain = fit_thrust(evidence(np.random.default_rng(1), rig=NONE_STATED), gravity_mps2=9.81)

    for key in ("motor.max_thrust_n", "motor.hover_mass_kg"):
        value, std = result.quantities[key].value, result.quantities[key].std
        assert std == pytest.approx(math.hypot(plain.quantities[key].std, value * math.hypot(0.006, 0.003)), rel=1e-6)
        assert result.common["gain of Fz"][key] == pytest.approx([0.006 * value])
    square = "motor.thrust_per_speed_squared_n_s2"
    assert result.common["tachometer"][square] == pytest.approx([-2 * 0.01 * result.quantities[square].value])
    quadratic = np.array(result.quantities["motor.thrust_speed_poly"].value)
    assert result.common["tachometer"]["motor.thrust_speed_poly"] == pytest.approx(0.01 * quadratic * [-2, -1, 0])


def test_the_covariance_grows_by_the_products_of_the_effects_and_agrees_with_the_uncertainties() -> None:
    result = fit_thrust(evidence(np.random.default_rng(1)), gravity_mps2=9.81)

    for block in result.covariances:
        std = [np.ravel(result.quantities[key].std) for key in block.of]
        assert np.sqrt(np.diag(block.matrix)) == pytest.approx(np.concatenate(std), rel=1e-6)
    assert result.quality["common_causes"]["motor.max_thrust_n"]["gain of Fz"] == pytest.approx(
        0.006 * result.quantities["motor.max_thrust_n"].value
    )
    assert any(line.startswith("  gain of Fz: motor.thrust_poly 0.6 %") for line in result.summary())


def test_cross_talk_of_thrust_adds_to_the_slope_of_the_torque_alone() -> None:
    result = fit_torque(evidence(np.random.default_rng(1)))

    assert result.common["cross-talk of Fz into Tz"]["motor.torque_poly"] == pytest.approx([2e-4, 0.0])
    slope, offset = result.quantities["motor.torque_poly"].value
    assert result.common["gain of Tz"]["motor.torque_poly"] == pytest.approx([0.02 * slope, 0.02 * offset])
    assert result.common["gain of Fz"]["motor.torque_poly"] == pytest.approx([-0.006 * slope, 0.0])
    assert result.common["linearity of the load cell"]["motor.torque_poly"] == pytest.approx([0.0, 0.003 * offset])


def test_scales_that_nobody_stated_are_named_once_and_change_nothing() -> None:
    result = fit_thrust(evidence(np.random.default_rng(1), rig=NONE_STATED), gravity_mps2=9.81)

    notes = [one.text for one in result.findings if one.code == "scale-taken-as-exact"]
    assert len(notes) == 1
    assert notes[0].startswith("taken as exact: gain of Fz, linearity of the load cell, tachometer: no standard")
    assert result.common == {}


def test_a_thrust_by_its_torque_goes_with_the_torques_gain_the_arm_and_the_thrusts_cross_talk() -> None:
    gain = Result(
        command="tf identify",
        method="default",
        quantities={
            "tf.static_gain_n": Parameter(value=2e-6, std=1e-8),
            "tf.numerator": Parameter(value=[0.0, 6e-8], std=[0.0, 1e-9]),
            "tf.time_constant_s": Parameter(value=0.065, std=1e-3),
        },
    )
    effects = power_law(gain.quantities, {"N": arm_scales([RIG])}, {"tf*.static_gain_n": {"N": 1}})
    result = with_common_causes(gain, effects)

    assert result.common["arm"]["tf.static_gain_n"] == pytest.approx([-0.01 * 2e-6])
    assert result.common["gain of Tx and Ty"]["tf.numerator"] == pytest.approx([0.0, 0.005 * 6e-8])
    assert result.common["cross-talk of Fz into Tx and Ty"]["tf.static_gain_n"] == pytest.approx([2e-4 / 0.046 * 2e-6])
    assert result.quantities["tf.time_constant_s"].std == 1e-3
    assert result.quantities["tf.numerator"].std[0] == 0.0


# Several fits


def test_the_slope_of_a_polynomial_is_compared_with_its_covariance() -> None:
    covariance = np.array([[4.0, -1.0], [-1.0, 1.0]]) * 1e-4
    section = Section(
        method="default",
        found=datetime(2026, 11, 22, tzinfo=UTC),
        cfid_version="0",
        accepted=True,
        sources=(),
        parameters={
            "motor.torque_poly": Parameter(value=[2.0, 1.0], std=[0.02, 0.01]),
            "a": Parameter(value=1.0, std=0.1),
        },
        covariance=covariance_between(
            {"a": 1.0, "motor.torque_poly": [2.0, 1.0]}, np.diag([0.01, 0, 0]) + np.pad(covariance, (1, 0))
        ),
        common={"scale": {"a": [0.08]}},
    )
    found = number_of(section, "motor.torque_poly", [3.0, 1.0])

    assert found.nominal_value == 7.0
    assert found.std_dev == pytest.approx(math.sqrt((36 - 6 + 1) * 1e-4))
    other = number_of(section, "a")
    assert (other.nominal_value, other.std_dev) == (1.0, pytest.approx(0.1))
    assert parts_of(other) == pytest.approx({"scale": 0.08, OWN_FIT: 0.06})
    assert (other - measured(0.8, 0.1, {"scale": 0.06})).std_dev == pytest.approx(math.sqrt(0.02 - 2 * 0.0048))
    with pytest.raises(ValueError, match="2 numbers"):
        number_of(section, "motor.torque_poly")


# Coverage, with scales drawn anew for each campaign


def _maps(rng: np.random.Generator) -> list[float]:
    errors = drawn_errors(rng)
    thrust, torque = fit_thrust(evidence(rng, errors), gravity_mps2=9.81), fit_torque(evidence(rng, errors))
    most, square = float(np.polyval(THRUST, 65535.0)), "motor.thrust_per_speed_squared_n_s2"
    speed = fit_speed(evidence(rng, errors)).quantities["motor.speed_poly"]
    given = thrust.quantities
    return [
        (given["motor.max_thrust_n"].value - most) / given["motor.max_thrust_n"].std,
        (given["motor.hover_mass_kg"].value - 4 * most / 9.81) / given["motor.hover_mass_kg"].std,
        (torque.quantities["motor.torque_poly"].value[0] - TORQUE_PER_THRUST)
        / torque.quantities["motor.torque_poly"].std[0],
        (speed.value[0] - SPEED[0]) / speed.std[0],
        (given[square].value - fit_square()) / given[square].std,
    ]


def fit_square() -> float:
    """Return k of thrust = k speed^2 for the motor without noise, as weighted least squares finds it."""
    thrust, speed = np.polyval(THRUST, COMMAND), np.polyval(SPEED, COMMAND)
    return float(thrust @ speed**2 / (speed**4).sum())


def _drag(rng: np.random.Generator) -> list[float]:
    """Return the errors of the simple model's coefficients in standard uncertainties.

    The true forces are turned into the cell's frame, falsified by the instruments, and turned back.
    """
    true = np.array([-9e-7, -9e-7, -1.5e-6])
    speeds = np.array([3.0, 4.0, 5.0])
    angles = np.radians([30.0, 60.0, 90.0])
    omega = np.array([6000.0, 8000.0])
    azimuth = math.radians(28.0)
    rows = [(v, a, w) for v in speeds for a in angles for w in omega]
    wind, angle, speed_sum = (np.array(each) for each in zip(*rows, strict=True))

    def velocity(about: float, times: float) -> Array:
        lateral = times * wind * np.sin(angle)
        return np.column_stack([lateral * math.cos(about), -lateral * math.sin(about), times * wind * np.cos(angle)])

    # A typed value is the truth times 1 + error, so the truth is drawn for a given reading.
    actual = velocity(azimuth - math.radians(rng.normal(0, 1.5)), 1 / (1 + rng.normal(0, 0.02)))
    force = true * actual * (speed_sum / (1 + rng.normal(0, 0.01)))[:, np.newaxis]
    off = math.radians(30.0 - rng.normal(0, 1.0))
    to_cell = np.array([[math.cos(off), math.sin(off), 0], [-math.sin(off), math.cos(off), 0], [0, 0, 1]])
    talk = rng.normal(0, 0.01, (3, 3))
    np.fill_diagonal(talk, [rng.normal(0, 0.01), rng.normal(0, 0.008), rng.normal(0, 0.006)])
    shown = (force @ to_cell.T) @ (np.eye(3) * (1 + rng.normal(0, 0.003)) + talk).T
    taken = math.radians(30.0)
    to_body = np.array([[math.cos(taken), -math.sin(taken), 0], [math.sin(taken), math.cos(taken), 0], [0, 0, 1]])
    noise = np.full((len(rows), 3), 1e-4)
    settings = np.unique(np.column_stack([wind, angle]), axis=0, return_inverse=True)[1].reshape(-1)
    runs = DragExperiments(
        command=speed_sum,
        angle_deg=np.degrees(angle),
        velocity_mps=velocity(azimuth, 1.0),
        speed_sum_rad_s=speed_sum,
        force_n=shown @ to_body.T + rng.normal(0, noise),
        force_std_n=noise,
        reference_std_n=np.zeros_like(noise),
        noise_known=True,
        setting=settings,
        wind_relative_std=np.full(len(rows), 1e-6),
        names=("",) * len(rows),
        rigs=(RIG,),
        tachometers=(RIG,),
    )
    found = fit_drag(runs).quantities["drag.simple_kg_per_rad"]
    return [(found.value[axis] - true[axis]) / found.std[axis] for axis in (0, 2)]


@pytest.mark.parametrize("campaign", [_maps, _drag], ids=["maps", "drag"])
@pytest.mark.parametrize(
    ("campaigns", "low", "high"), [(60, 0.88, 0.995), pytest.param(1000, 0.93, 0.97, marks=pytest.mark.slow)]
)
def test_intervals_hold_the_truth_when_every_scale_errs_by_what_is_stated(
    campaign: Callable[[np.random.Generator], list[float]], campaigns: int, low: float, high: float
) -> None:
    scores = np.array([campaign(np.random.default_rng(20261122 + number)) for number in range(campaigns)])
    covered = (np.abs(scores) < 1.96).mean(axis=0)

    print(campaign.__name__, covered, scores.std(axis=0))
    assert low <= covered.mean() <= high
    assert covered.min() >= low - 0.02
