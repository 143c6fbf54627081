"""A flight's own parameters predict it best; flights that were used for a fit are refused, as are incomplete sets."""

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cfid.errors import ConfigError, DataError
from cfid.flight.data import FlownLog, flight_of, read_flight
from cfid.flight.estimation import CrossedError
from cfid.flight.model import ThrustLag
from cfid.flight.rows import LEVER
from cfid.flight.supply import with_usable_voltage
from cfid.published import published_sets
from cfid.recordings.crazyflie import si_values
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Series
from cfid.records.fits import path_of
from cfid.records.parameters import Parameter, Section, Source
from cfid.validation.predictions import HORIZONS, ParameterSet, errors, starts
from cfid.validation.result import SetError, compared, validate
from cfid.validation.sets import Measured, measured_file, measured_in, published_parameters, sets_of
from tests.flight.flying import GYRO_DELAY_S, LATE_STEPS, STEP, Fleet, fleet, fly
from tests.lab import DATA, Cfid, keep, new_campaign, values_of
from tests.recordings.made import only, with_rows
from tests.recordings.made import table_of as rows_in
from tests.report.fits_by_hand import put

FLIGHTS = DATA / "flights"
SLOW_WINDS = (
    (22, 1.0, 1.0),
    *((seed, size, wind) for seed in (23, 24, 25, 26) for size, wind in ((0.4, 1.5), (1.0, 1.0), (1.0, 0.3))),
)


def truth(vehicles: Fleet, place: int = 0) -> ParameterSet:
    gain, idle = float(vehicles.gain[place]), float(vehicles.idle[place])
    roll, pitch, yaw = vehicles.moments[place].tolist()
    return ParameterSet(
        name="truth",
        origin="the plant",
        mass_kg=float(vehicles.mass[place]),
        moments_kg_m2=(roll, pitch, yaw),
        arm_m=float(vehicles.lever[place]) / LEVER,
        torque_m=float(vehicles.torque[place]),
        thrust_n=(vehicles.k * idle**2, 2 * vehicles.k * idle * gain, vehicles.k * gain**2),
        in_volts=False,
        lag=ThrustLag(float(vehicles.rising[place]), float(vehicles.falling[place])),
        delay_s=LATE_STEPS * STEP + GYRO_DELAY_S,
        drag_per_s=(float(vehicles.braking[place]), float(vehicles.braking[place])),
    )


@pytest.fixture(scope="module")
def flown() -> tuple[ParameterSet, FlownLog]:
    rng = np.random.default_rng(11)
    vehicles = fleet(1, rng)
    return truth(vehicles), flight_of(fly(vehicles, rng, seconds=24.0, wind=0.1)[0])


def of(table: list[SetError], quantity: str, horizon_s: float, name: str) -> SetError:
    return next(
        one for one in table if (one.quantity, one.name) == (quantity, name) and abs(one.horizon_s - horizon_s) < 1e-9
    )


def table_of(flown: FlownLog, *sets: ParameterSet) -> list[SetError]:
    at = starts(flown.by_command)
    return compared({one.name: errors(flown.by_command, one, at) for one in sets})


def test_the_true_parameters_predict_rates_and_velocity(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    table = table_of(flight, true)
    moved = float(np.sqrt(np.mean(np.sum(flight.flight.rates[flight.flight.driven] ** 2, axis=1))))
    assert of(table, "rates", 0.1, "truth").error < 0.15 * moved  # air damps rotation by 1.5 1/s, which no set has
    assert of(table, "attitude", 0.1, "truth").error < 2.0
    assert of(table, "velocity", 0.1, "truth").error < 0.05


@pytest.mark.parametrize(
    ("quantity", "horizon_s", "wrong"),
    [
        ("rates", 0.1, {"moments_kg_m2": (2e-5, 2e-5, 3e-5)}),
        ("rates", 0.1, {"lag": None}),
        ("velocity", 0.5, {"mass_kg": 0.025}),
    ],
)
def test_wrong_parameters_predict_worse_beyond_the_interval(
    flown: tuple[ParameterSet, FlownLog], quantity: str, horizon_s: float, wrong: dict[str, object]
) -> None:
    true, flight = flown
    other = replace(true, name="wrong", **wrong)  # type: ignore[arg-type]
    one = of(table_of(flight, true, other), quantity, horizon_s, "wrong")
    assert one.more > one.half_width > 0


def test_rows_beyond_the_range_of_a_gyro_are_no_truth(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    series = only(flight.log)
    rows = rows_in(series)
    rows[:, 5:8] = np.clip(rows[:, 5:8], -5.0, 5.0)
    clipped = flight_of(with_rows(flight.log, rows))
    at = starts(clipped.by_command)
    assert len(at) < len(starts(flight.by_command))
    assert not any(clipped.flight.beyond[begin : begin + max(HORIZONS) + 1].any() for begin in at)
    whole, left = (of(table_of(one, true), "rates", 0.1, "truth").error for one in (flight, clipped))
    assert left < 1.2 * whole


def test_a_voltage_without_the_sag_under_load_judges_no_set() -> None:
    rng = np.random.default_rng(11)
    (log,) = fly(fleet(1, rng), rng, seconds=24.0, wind=0.1, load_sag=0.08, with_volts=True)
    rows = rows_in(log)
    rows[:, -1] = np.repeat(rows[::50, -1], 50)[: len(rows)]
    rare, whole = (with_usable_voltage(flight_of(each)) for each in (with_rows(log, rows), log))
    assert (rare.flight.in_volts, whole.flight.in_volts) == (False, True)
    assert "flight-voltage-unknown" in [one.code for one in rare.findings]
    assert rare.flight is rare.by_command


def test_a_flight_that_a_campaign_was_fitted_to_is_refused(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    with pytest.raises(DataError, match="validate with another flight"):
        validate(flight, [true], used=[fitted_to(flight.log.source.sha256)])


def fitted_to(sha256: str, path: str = "gone.csv", folder: Path = Path()) -> Measured:
    section = Section(
        method="default",
        found=datetime(2026, 1, 1, tzinfo=UTC),
        cfid_version="0.2.0",
        accepted=True,
        sources=(Source(path, sha256),),
        parameters={"flight.mass_kg": Parameter(value=0.027)},
    )
    return Measured(name="campaign", folder=folder, values=values_of({"flight": section}), rig=None)


@pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the public flights are not here (CFID_DATA)")
def test_a_flight_that_was_fitted_to_is_refused_in_another_format_too(tmp_path: Path) -> None:
    log = read_recording(FLIGHTS / "eschmann_log10.usd")
    series = only(log)
    names = [
        *(f"motor.m{motor}" for motor in (1, 2, 3, 4)),
        *(f"{one}.{axis}" for one in ("acc", "gyro") for axis in "xyz"),
    ]
    write_table(series, names, tmp_path / "copy.csv")
    used = fitted_to("another", str(FLIGHTS / "eschmann_log10.usd"))
    with pytest.raises(DataError, match="were fitted to this flight"):
        validate(read_flight(tmp_path / "copy.csv"), [published("thesis")], used=[used])


def write_table(series: Series, names: Sequence[str], path: Path) -> None:
    """Write channels of a log as a table in the firmware's units."""
    frame = pd.DataFrame({"t_s": series.time_s} | {name: si_values(series.column(name)) for name in names})
    frame.loc[:, [f"acc.{axis}" for axis in "xyz"]] /= 9.81
    frame.loc[:, [f"gyro.{axis}" for axis in "xyz"]] *= 180 / np.pi
    frame.to_csv(path, index=False)


def flights_file(path: Path, **changed: object) -> Path:
    """Write a kept fit of flights, with some of its parameters changed, and return its path."""
    values: dict[str, object] = {
        "flight.thrust_poly": [4.4e-11, -1.5e-6, 0.0528],
        "flight.rising_s": 0.046,
        "flight.falling_s": 0.074,
        "flight.delay_s": 0.007,
        "flight.inertia_kg_m2.roll": 1.45e-5,
        "flight.inertia_kg_m2.pitch": 1.5e-5,
        "flight.mass_kg": 0.027,
        "flight.arm_m": 0.046,
    }
    parameters = {key: Parameter(value=value) for key, value in (values | changed).items() if value is not None}
    section = replace(fitted_to("").values.fits[0].section, sources=(), parameters=parameters)
    return path_of(path.parent / "fits", keep(path.parent, "flight", section)).rename(path)


@pytest.mark.parametrize(
    "seed", [11, pytest.param(12, marks=pytest.mark.slow), pytest.param(13, marks=pytest.mark.slow)]
)
def test_a_set_without_the_logs_delay_is_judged_by_its_moments_and_lags(cfid: Cfid, tmp_path: Path, seed: int) -> None:
    """The delay of 7 ms is the recording's: true sets of a rig, which have none, did worse than moments 15 % wrong."""
    rng = np.random.default_rng(seed)
    vehicles = fleet(1, rng)
    true, flight = truth(vehicles), flight_of(fly(vehicles, rng, seconds=24.0, wind=0.1)[0])
    series = only(flight.log)
    write_table(series, series.names[:10], tmp_path / "flight.csv")
    assert true.lag is not None
    body = {
        "flight.thrust_poly": [one / 65535**power for power, one in reversed(list(enumerate(true.thrust_n)))],
        "flight.mass_kg": true.mass_kg,
        "flight.arm_m": true.arm_m,
    }

    def written(name: str, *, moments: float = 1.0, lags: float = 1.0, delay_s: float = 0.0) -> str:
        roll, pitch, _ = (moments * one for one in true.moments_kg_m2)
        changed = {"flight.inertia_kg_m2.roll": roll, "flight.inertia_kg_m2.pitch": pitch, "flight.delay_s": delay_s}
        rising_s, falling_s = (lags * one for one in true.lag or ())
        changed |= {"flight.rising_s": rising_s, "flight.falling_s": falling_s}
        flights_file(tmp_path / name, **(body | changed))
        return name

    late_s = true.delay_s
    names = [
        written("true.json"),
        *(written(f"moments{share}.json", moments=share, delay_s=late_s) for share in (0.85, 0.9, 1.1, 1.15)),
        written("lags.json", lags=1.15),
    ]
    ended = cfid(
        "validate", "flight.csv", *(word for name in names for word in ("--with", name)), "--no-figures", "--json"
    )
    assert ended.returncode == 0, ended.stderr
    rows = [row for row in json.loads(ended.stdout)["quality"]["errors"] if row["quantity"] == "next rates"]

    assert len(rows) == len(names)
    assert all(row["more"] > row["half_width"] > 0 for row in rows[1:])


def test_a_kept_fit_is_read_by_its_own_name_and_needs_no_rig(tmp_path: Path) -> None:
    (own,), missing = sets_of(measured_file(flights_file(tmp_path / "own.json")), in_volts=False)
    other = flights_file(tmp_path / "other.json", **{"flight.inertia_kg_m2.roll": 3e-5})
    (edited,), _ = sets_of(measured_file(other), in_volts=False)
    assert (own.moments_kg_m2[0], edited.moments_kg_m2[0]) == (1.45e-5, 3e-5)
    assert own.name != edited.name
    assert "no rig.toml with mass and arm" in missing[0]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"flight.inertia_kg_m2.pitch": -1.5e-5}, "pitch -1.5e-05"),
        ({"flight.inertia_kg_m2.roll": 146.0}, "times mass times arm squared"),
        ({"flight.mass_kg": float("nan")}, "flight.mass_kg"),
        ({"flight.falling_s": 60.0}, "lags of 0.046 and 60 s"),
        ({"flight.rising_s": None}, "flight.rising_s"),
    ],
)
def test_parameters_that_no_vehicle_has_make_no_set(tmp_path: Path, changed: dict[str, object], said: str) -> None:
    found, missing = sets_of(measured_file(flights_file(tmp_path / "own.json", **changed)), in_volts=False)
    assert found == []
    assert said in missing[-1]


def test_what_was_rejected_is_so_named() -> None:
    one = fitted_to("")
    section = replace(one.values.fits[0].section, rejected={"flight.rising_s": "open by 13 %."})
    with pytest.raises(KeyError, match=r"flight\.rising_s was rejected: open by 13 %"):
        replace(one, values=values_of({"flight": section}))["flight.rising_s"]


def test_no_set_two_of_a_name_and_short_flights_are_refused(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    with pytest.raises(ConfigError, match="no parameter set"):
        validate(flight, [], used=())
    with pytest.raises(ConfigError, match="name each once"):
        validate(flight, [true, true], used=())
    with pytest.raises(DataError, match="fly for longer"):
        validate(flight_of(flight.log, to_s=6.0), [true], used=())


def published(name: str) -> ParameterSet:
    return published_parameters(published_sets()[name], in_volts=True)


@pytest.mark.parametrize("name", ["thesis", "gym-pybullet-drones", "firmware"])
def test_published_sets_carry_a_crazyflie(name: str) -> None:
    one = published(name)
    drive = np.array([2.2, 3.6]) if one.in_volts else np.array([0.4, 0.95])
    low, high = 4 * np.polynomial.polynomial.polyval(drive, one.thrust_n)
    assert low < 9.81 * one.mass_kg < high


def test_a_set_that_states_too_little_is_left_out_and_named(
    flown: tuple[ParameterSet, FlownLog], cfid: Cfid, tmp_path: Path
) -> None:
    series = only(flown[1].log)
    write_table(series, series.names[:10], tmp_path / "flight.csv")
    done = cfid("--json", "validate", "flight.csv", "--with", "all", "--no-figures")
    assert done.returncode == 0, done.stderr
    used = set(json.loads(done.stdout)["quality"]["sets"])
    assert used >= {"thesis", "gym-pybullet-drones"}
    left_out = published_sets().keys() - used
    assert "landry" in left_out
    assert all(name in done.stderr for name in left_out)
    assert cfid("validate", "flight.csv", "--with", "nobody", "--no-figures").returncode == 2


def test_a_published_set_that_needs_a_voltage_is_left_out_where_others_need_none(
    flown: tuple[ParameterSet, FlownLog], cfid: Cfid, tmp_path: Path
) -> None:
    series = only(flown[1].log)
    write_table(series, series.names[:10], tmp_path / "flight.csv")
    both = cfid("validate", "flight.csv", "--with", "firmware", "--with", "thesis", "--no-figures")
    assert both.returncode == 0, both.stderr
    assert any(line.split()[:2] == ["thesis", "28"] for line in both.stdout.splitlines())
    alone = cfid("validate", "flight.csv", "--with", "firmware", "--no-figures")
    assert alone.returncode == 2


def test_a_rig_gives_a_set_along_forward_left_and_up(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    matrix = [[1.4e-5, 0.0, 0.0], [0.0, 1.6e-5, 0.0], [0.0, 0.0, 2.9e-5]]
    for section, key, value in (
        ("inertia", "inertia.matrix_kg_m2", matrix),
        ("thrust", "motor.thrust_poly", [2.13e-11, 1.0326e-6, 5.48e-4]),
        ("torque", "motor.torque_poly", [0.006, 1e-5]),
        ("tf", "tf.time_constant_s", 0.065),
    ):
        put(campaign, section, {key: Parameter(value=value)})
    (one,), missing = sets_of(measured_in(campaign), in_volts=True)
    forward = "xyz".index(campaign.rig.vehicle.body_frame.forward[-1])
    assert one.moments_kg_m2[0] == matrix[forward][forward]
    full = 2.13e-11 * 65535**2 + 1.0326e-6 * 65535 + 5.48e-4
    assert sum(one.thrust_n) == pytest.approx(full)
    assert one.lag == ThrustLag(0.065, 0.065)
    assert "no set of the flight" in missing[0]


@pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the public flights are not here (CFID_DATA)")
def test_a_lag_predicts_a_public_flight_better_than_none() -> None:
    flight = read_flight(FLIGHTS / "eschmann_log15.usd", from_s=15.94, to_s=51.36)
    sets = [published(name) for name in ("thesis", "gym-pybullet-drones")]
    result = validate(flight, sets, used=())
    assert result.quality["segments"] == 33
    one = of(table_of(flight, *sets), "rates", 0.1, "gym-pybullet-drones")
    assert one.more > one.half_width


@pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the public flights are not here (CFID_DATA)")
def test_a_campaign_fitted_to_one_flight_is_validated_by_another(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", "campaign", "--kind", "simulated").returncode == 0
    campaign = tmp_path / "campaign"
    body = ("--mass-kg", "0.027:0.0003", "--arm-mm", "46:0.3", "--no-figures")
    windows = ("--from", "15.94", "--to", "33.6")
    log15, log10 = FLIGHTS / "eschmann_log15.usd", FLIGHTS / "eschmann_log10.usd"
    fitted = cfid("fit", "flight", log15, *windows, *body, folder=campaign)
    assert fitted.returncode == 0, fitted.stderr
    words = ("--with", "thesis", "--with", "gym-pybullet-drones", "--no-figures")
    found = cfid("validate", log10, "--from", "8.76", "--to", "39.12", *words, folder=campaign)
    print(found.stdout, found.stderr)
    assert found.returncode == 0, found.stderr
    assert "campaign (flight)" in found.stdout
    # In this flight of climbs, disturbances turned the vehicle by more than its rates changed.
    assert "who predicts that they stay errs by 0.72 rad/s, every set by 1.53 and more" in found.stderr
    again = cfid("validate", log15, *words, folder=campaign)
    assert again.returncode == 4
    assert "validate with another flight" in again.stderr


def test_a_flight_that_shows_moments_has_no_warning_of_rates(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    heavier = replace(true, name="heavier", moments_kg_m2=(2e-5, 2e-5, 3e-5))
    found = validate(flight, [true, heavier], used=())
    assert "validation-rates-unpredicted" not in [one.code for one in found.findings]
    turning = replace(flight.by_command, rates=0.02 * flight.by_command.rates)  # as if something held the vehicle
    held = validate(replace(flight, flight=turning), [true, heavier], used=())
    assert "validation-rates-unpredicted" in [one.code for one in held.findings]


@pytest.fixture(
    scope="module",
    params=[(9, 0.1), *(pytest.param(one, marks=pytest.mark.slow) for one in ((6, 0.1), (6, 1.0), (8, 1.0)))],
)
def hovering(request: pytest.FixtureRequest) -> tuple[ParameterSet, FlownLog]:
    """A flight that hovers, in gusts or in nearly still air."""
    seed, wind = request.param
    rng = np.random.default_rng(seed)
    vehicles = fleet(1, rng)
    flight = flight_of(fly(vehicles, rng, seconds=24.0, wind=wind, hover=True)[0])
    return truth(vehicles), flight


def wrong_sets(true: ParameterSet, *, moments: Sequence[float], lags: Sequence[float]) -> list[ParameterSet]:
    """Return sets whose moments or lags are these shares of the true ones."""
    assert true.lag is not None
    of_moments = {share: tuple(share * np.array(true.moments_kg_m2)) for share in moments}
    of_lags = {share: ThrustLag(*(share * tau_s for tau_s in true.lag)) for share in lags}
    return [
        *(replace(true, name=f"moments {share}", moments_kg_m2=each) for share, each in of_moments.items()),
        *(replace(true, name=f"lags {share}", lag=each) for share, each in of_lags.items()),
    ]


def test_on_a_flight_that_hovers_no_moments_and_lags_are_better_than_the_true_ones(
    hovering: tuple[ParameterSet, FlownLog],
) -> None:
    true, flight = hovering
    wrong = wrong_sets(true, moments=(0.94, 1.06, 1.3), lags=(0.8, 1.2))
    lighter = replace(true, name="lighter", mass_kg=0.9 * true.mass_kg)
    found = validate(flight, [true, *wrong, lighter], used=())
    rows = [row for row in found.quality["errors"] if "half_width" in row]
    assert not [row for row in rows if row["more"] + row["half_width"] < 0]
    assert {row["quantity"] for row in rows} == {"velocity"}
    assert all(row["more"] == 0 for row in rows if row["name"].split()[0] in ("moments", "lags"))
    assert all(row["more"] > row["half_width"] for row in rows if row["name"] == "lighter")
    assert "validation-not-excited" in [one.code for one in found.findings if one.severity == "warning"]
    assert found.accepted  # without excitation no delay shows
    assert "flight-delay-implausible" not in [one.code for one in found.findings]


@pytest.mark.parametrize("size", [0.12, pytest.param(1.0, marks=pytest.mark.slow)])
def test_manoeuvres_show_moments_also_where_they_are_gentle(size: float) -> None:
    """In calm air, rotors that turn a vehicle by 4 rad/s^2 judge moments as well as quick tilts do."""
    rng = np.random.default_rng(12)
    vehicles = fleet(1, rng)
    true = truth(vehicles)
    larger = replace(true, name="larger", moments_kg_m2=(2e-5, 2e-5, 3e-5))
    found = validate(
        flight_of(fly(vehicles, rng, seconds=24.0, size=size, wind=0.02, noise=0.2)[0]), [true, larger], used=()
    )
    assert "validation-not-excited" not in [one.code for one in found.findings if one.severity == "warning"]
    (rates,) = [row for row in found.quality["errors"] if (row["quantity"], row["name"]) == ("next rates", "larger")]
    assert rates["more"] > rates["half_width"] > 0


@pytest.mark.parametrize(
    ("seed", "size", "wind"),
    [(21, 0.4, 1.5), *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW_WINDS)],
)
def test_in_wind_no_wrong_moments_or_lags_are_better_than_the_true_ones(seed: int, size: float, wind: float) -> None:
    rng = np.random.default_rng(seed)
    vehicles = fleet(1, rng)
    true = truth(vehicles)
    wrong = wrong_sets(true, moments=(0.87, 1.06, 1.15), lags=(0.7, 1.3))
    flight = flight_of(fly(vehicles, rng, seconds=40.0, size=size, wind=wind)[0])
    found = validate(flight, [true, *wrong], used=())
    judging = [row for row in found.quality["errors"] if "half_width" in row]
    assert not [row for row in judging if row["more"] + row["half_width"] < 0]
    rates = {row["name"]: row for row in judging if row["quantity"] == "next rates"}
    assert all(rates[name]["more"] > rates[name]["half_width"] for name in ("moments 0.87", "moments 1.15", "lags 1.3"))
    assert {row["quantity"] for row in judging} == {"next rates", "vertical velocity"}


def test_a_log_whose_axes_motors_or_units_are_others_is_rejected(flown: tuple[ParameterSet, FlownLog]) -> None:
    true, flight = flown
    assert not validate(flight, [true], used=()).rejected
    turned = replace(flight.flight, rates=flight.flight.rates * [-1.0, 1.0, 1.0])
    mirrored = replace(flight, flight=turned)
    assert "flight-wrong-way" in [one.code for one in validate(mirrored, [true], used=()).findings]
    other = replace(flight.by_command, command=flight.flight.command[:, [1, 2, 3, 0]])
    with pytest.raises(CrossedError):
        validate(replace(flight, flight=other), [true], used=())
    slow = replace(flight.flight, rates=np.radians(flight.flight.rates), velocity=None, attitude=None)
    in_degrees = validate(replace(flight, flight=slow), [true], used=())
    assert not in_degrees.accepted
    assert "flight-moment-unlike-arm" in [one.code for one in in_degrees.findings]
