"""The firmware's formula from thrust to motor voltage, compiled in single precision, stops no motor with our maps."""

import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.estimate.voltage_cubic import cubic_fault, least_thrust_n
from cfid.export.samples import impossible
from cfid.motors.maps.estimation import compare_thrust
from cfid.motors.points import frame
from cfid.records.covariances import numbers_of
from tests.export.reading import TARGETS, export, macros
from tests.export.thesis_vehicle import vehicle, with_value
from tests.lab import sections_at

Array = npt.NDArray[np.float64]
Inverse = Callable[..., tuple[Array, Array]]

ROUNDING = 6.5  # of 65535: the largest fall of a motor command by single precision; a brushed motor has steps of 256
BATTERIES_V = (3.0, 3.3, 3.7, 4.2)

# VMOTOR2THRUST0..3, THRUST_MIN, THRUST_MAX of src/platform/interface/platform_defaults_cf2.h and _cf21bl.h.
SHIPPED = {
    "2.1+ propellers, 2026.08": (
        (-0.02476537915958403, 0.06523793527519485, -0.026792504967750107, 0.006776789303971145),
        (0.012817578393224994, 0.12),
    ),
    "thrust upgrade kit, 2026.08": (
        (0.006728127583707208, 0.01011557616217668, 0.010263198062061085, 0.0028358638322392503),
        (0.01922636758983749, 0.18),
    ),
    "thrust upgrade kit, 2025.12": (
        (-0.03978221591250353, 0.10979738851226176, -0.05545304285403245, 0.016215002062640885),
        (0.01922636758983749, 0.18),
    ),
    "legacy propellers, 2026.08": (
        (-0.014830744918356092, 0.04724465241828281, -0.01847364358025878, 0.005960923942142),
        (0.012817578393224994, 0.12),
    ),
    "brushless, 2026.08": (
        (-0.014058926705279723, 0.04265273261724981, 0.0018327760144017432, 0.0020576974784587178),
        (0.02136263065537499, 0.2),
    ),
}


@pytest.fixture(scope="module")
def inverse(tmp_path_factory: pytest.TempPathFactory) -> Inverse:
    """Return a function that gives motor voltages and commands (65536,) for a map and a battery voltage."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no gcc to compile the firmware's formula with")
    program = tmp_path_factory.mktemp("inverse") / "invert_thrust"
    source = Path(__file__).with_name("invert_thrust.c")
    flags = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-Wdouble-promotion")
    subprocess.run([compiler, *flags, "-o", str(program), str(source), "-lm"], check=True)

    def run(*numbers: float) -> tuple[Array, Array]:
        given = " ".join(f"{number:.9g}" for number in numbers).encode()
        made = subprocess.run([str(program)], input=given, stdout=subprocess.PIPE, check=True).stdout
        volts, command = np.frombuffer(made, dtype=np.float32).reshape(65536, 2).T.astype(np.float64)
        return volts, command

    return run


def assert_flies(
    inverse: Inverse, cubic: npt.ArrayLike, limits: tuple[float, float], *, fall: float = ROUNDING
) -> None:
    """Check all commands at all battery voltages; thrusts come back within 1 % of the range."""
    lowest_first = np.asarray(cubic, dtype=np.float64)
    least, most = limits
    wanted = np.arange(65536) / 65535 * most
    worst = 0.0
    for battery_v in BATTERIES_V:
        volts, command = inverse(*lowest_first, least, most, battery_v)
        assert np.isfinite(volts).all()
        assert np.isfinite(command).all()
        assert np.max(np.maximum.accumulate(command) - command) <= fall
        assert volts.min() >= 0
        asked = wanted >= least * (1 + 1e-6)
        given = asked & (wanted <= np.polyval(lowest_first[::-1], battery_v))
        assert given.any()
        got = np.polyval(lowest_first[::-1], np.minimum(command, 65535) / 65535 * battery_v)
        worst = max(worst, float(np.max(np.abs(got - wanted)[given])) / (most - least))
    assert worst < 0.01


def assert_text_flies(inverse: Inverse, header: str) -> None:
    found = macros(header)
    written = [found[f"VMOTOR2THRUST{power}"] for power in range(4)]
    assert_flies(inverse, written, (found["THRUST_MIN"], found["THRUST_MAX"]))


@pytest.mark.parametrize("name", SHIPPED)
def test_maps_that_the_firmware_ships_come_back(inverse: Inverse, name: str) -> None:
    cubic, limits = SHIPPED[name]
    assert_flies(inverse, cubic, limits)
    assert cubic_fault(cubic, max_thrust_n=limits[1]) == cubic_fault(cubic) == ""
    assert limits[0] / limits[1] == pytest.approx(7000 / 65535, rel=1e-6)  # the rule that headers follow


@pytest.mark.parametrize(
    "cubic",
    [
        [0.0036, 0.0072, 0.0113, -0.00034],  # of a plain fit
        [0.02, 0.01, 0.012, 0.002],  # flat within the thrusts that are asked for
        [0.0, 0.03, -0.03, 0.006],
        [0, 0.04, 0, 1e-30],  # single precision has no inverse
        [100, 0.01, 0, 0.001],
        [9.1322e-4, 0.0157323, 0.00557237, 0.000662268],  # c2^2 = 0.993 * 3 c1 c3: commands would fall by rounding
        [0, 1e-3, 0, 1e-5],  # reaches no thrust
    ],
)
def test_a_map_that_the_firmware_cannot_invert_is_no_header(cubic: list[float]) -> None:
    known = with_value(with_value(vehicle(), "motor.thrust_voltage_poly", cubic), "motor.max_thrust_n", 0.16)
    with pytest.raises(DataError, match=r"motor\.thrust_voltage_poly"):
        export("firmware", known)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_that_all_but_touches_the_limit_moves_inward_until_its_header_flies(inverse: Inverse, seed: int) -> None:
    """Ordinary motors have c2^2 = 0.98 * 3 c1 c3, where the formula subtracts nearly equal single-precision numbers."""
    rng = np.random.default_rng(seed)
    command = np.repeat(np.arange(4000.0, 65000.0, 4000.0), 2)
    vbat_v = 4.0 - 0.4 * command / 65535 - 0.02 * rng.random(len(command))
    volts = command / 65535 * vbat_v
    thrust = 0.00077 + 0.0158 * volts + 0.00558 * volts**2 + 0.00066 * volts**3
    measured = thrust + 1e-4 * rng.standard_normal(len(command))
    most_n = 1.04 * float(thrust.max())
    found = compare_thrust(frame(command, vbat_v=vbat_v, thrust_n=measured), max_thrust_n=most_n)

    assert not found.rejected
    known = with_value(vehicle(), "motor.thrust_voltage_poly", found.lowest_first.tolist())
    assert_text_flies(inverse, export("firmware", with_value(known, "motor.max_thrust_n", most_n)))


def test_every_cubic_that_is_drawn_and_delivered_gives_its_thrusts(inverse: Inverse) -> None:
    """Near the firmware's limit, rounding lets motor commands fall, which is no reason to reject a vehicle."""
    rng = np.random.default_rng(1)
    draws = np.array([5.8e-4, 0.0155, 5.68e-3, 6.94e-4]) * (1 + 3e-3 * rng.standard_normal((40, 4)))
    given = [
        row for row in draws if not impossible({"motor.thrust_voltage_poly": row.tolist(), "motor.max_thrust_n": 0.16})
    ]

    assert 30 < len(given) <= 40
    for cubic in given:
        assert_flies(inverse, cubic, (least_thrust_n(cubic.tolist(), 0.16), 0.16), fall=math.inf)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 7])
def test_headers_of_whole_campaigns_fly_and_their_covariances_agree_with_their_uncertainties(
    inverse: Inverse, seed: int, tmp_path: Path
) -> None:
    folder = tmp_path / "campaign"
    words = ["demo", str(folder), "--seed", str(seed), "--no-figures"]
    subprocess.run([sys.executable, "-m", "cfid.cli.main", *words], check=True, capture_output=True, timeout=600)
    assert_text_flies(inverse, (folder / "exports" / TARGETS["firmware"].file_name).read_text())
    for section in sections_at(folder).values():
        for kept in section.covariance:
            spread = iter(np.sqrt(np.diag(np.array(kept.matrix))))
            for key in kept.of:
                parameter = section.parameters[key]
                for std in numbers_of(key, parameter.std):
                    known = std is not None and math.isfinite(std)  # a number at its bound has no finite std
                    assert next(spread) == pytest.approx(std if known else 0.0, rel=1e-6), key
