"""Figures of motors: staircases with windows and reasons, maps with bands, the battery, spectral lines of rotors."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from cfid.estimate.staircase import Staircase, reduce_staircase
from cfid.motors.maps.data import Reduced
from cfid.motors.maps.estimation import compare_thrust, fit_map
from cfid.motors.maps.figures import (
    map_figure,
    staircase_figure,
    voltage_figure,
)
from cfid.motors.panels import scientific
from cfid.motors.points import Points, frame
from cfid.motors.vibration.figures import rotor_figure
from cfid.recordings.wrench import WrenchRecord
from cfid.records.parameters import Source
from cfid.records.run import Label
from tests.motors.stand_in_a_folder import climbed

Look = Callable[[Figure], Any]
Array = npt.NDArray[np.float64]

RATE_HZ = 500.0
COMMANDS = (10000, 20000, 30000, 40000)


def reduced() -> tuple[Array, Array, Staircase]:
    """Return times, Fz and steps of four commands."""
    record = climbed(COMMANDS, hold_s=3.0, rest_s=2.0, rate_hz=RATE_HZ, spikes_per_s=0.0)
    steps = reduce_staircase(
        time_s=record.time_s,
        channels=record.wrench,
        command_time_s=record.command_time_s,
        commands=record.commands,
    )
    return record.time_s, record.wrench[:, 2], steps


def _windows(axes: Axes, label: str) -> list[tuple[float, float]]:
    spans = [each for each in axes.collections if isinstance(each, PolyCollection) and each.get_label() == label]
    corners = [path.vertices for span in spans for path in span.get_paths()]
    return [(float(each[:, 0].min()), float(each[:, 0].max())) for each in map(np.asarray, corners)]


def _line(axes: Axes, label: str) -> tuple[Array, Array]:
    (found,) = (line for line in axes.get_lines() if line.get_label() == label)
    x, y = found.get_data()
    return np.asarray(x), np.asarray(y)


def _written(page: Any) -> str:
    return " ".join(text.get_text() for text in page.texts())


# Staircases


def test_windows_and_means_of_settled_steps_are_the_points(look: Look) -> None:
    time, fz, found = reduced()
    page = look(staircase_figure(Reduced("2026-11-21_$x$", time, fz, found)))
    thrust = page.panel("(a)")
    assert _windows(thrust, "window") == pytest.approx(np.array([(p.begin_s, p.end_s) for p in found.points]))
    assert _windows(thrust, "not used") == []
    (means,) = (each for each in thrust.collections if each.get_label() == "mean")
    assert [path.vertices[0, 1] for path in means.get_paths()] == pytest.approx(
        [p.mean[2] + p.tare[2] for p in found.points]
    )
    assert page.red() == ""
    assert page.overlapping() == []


# Maps


def _points(*, std: bool = True, wild: Sequence[int] = ()) -> Points:
    command = np.arange(0.0, 64001.0, 4000.0)
    rng, running = np.random.default_rng(3), command > 1000
    thrust = np.where(running, np.polyval((2.13e-11, 1.03e-6, 5.5e-4), command), 0.0)
    thrust += 1e-4 * rng.standard_normal(len(command)) + np.where(np.isin(command, wild), 0.02, 0.0)
    speed = np.where(running, 0.04 * command + 400 + 4 * rng.standard_normal(len(command)), 0.0)
    return frame(
        command,
        thrust_n=thrust,
        torque_nm=0.006 * thrust + 1e-6 * rng.standard_normal(len(command)),
        speed_rad_s=speed,
        thrust_std_n=np.full_like(command, 1e-4) if std else None,
        torque_std_nm=np.full_like(command, 1e-6) if std else None,
        speed_std_rad_s=np.full_like(command, 4.0) if std else None,
    )


def test_a_maps_points_curve_and_residuals_are_its_own(look: Look) -> None:
    mapped = fit_map("thrust", _points())
    page = look(map_figure(mapped))
    curve, left = page.panel("(a)"), page.panel("(b)")
    assert np.array(_line(curve, "points ± standard uncertainty")) == pytest.approx(np.array([mapped.x, mapped.y]))
    assert _line(left, "points ± standard uncertainty")[1] == pytest.approx(mapped.fit.residual)
    x, y = _line(curve, "polynomial")
    assert (x[0], x[-1]) == (mapped.x.min(), mapped.x.max())
    assert y == pytest.approx(mapped.fit.at(x))
    (bars,) = (each for each in left.collections if isinstance(each, LineCollection))
    lengths = [segment[1, 1] - segment[0, 1] for segment in bars.get_segments()]
    assert lengths == pytest.approx(2 * mapped.fit.point_std)
    assert page.red() == ""
    assert page.overlapping() == []


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [
        (2.130295e-11, 1.3e-14, "(2.1303 ± 0.0013)·10⁻¹¹ N"),
        (-2.130295e-11, float("nan"), "−2.1303·10⁻¹¹ N"),
        (420.942, 1.25, "420.9 ± 1.2 N"),
        (0.0, 0.0, "0 N"),
    ],
)
def test_a_small_value_shares_its_power_of_ten_with_its_deviation(value: float, std: float, written: str) -> None:
    assert scientific(value, std, unit="N").replace("-", "−") == written


# Thrust over speed and over voltage


def test_voltage_and_command_stand_side_by_side_with_their_errors(look: Look) -> None:
    up_and_down = np.concatenate([np.arange(4000.0, 64001.0, 4000.0), np.arange(64000.0, 3999.0, -4000.0)])
    vbat = 4.1 - 0.5 * (up_and_down / 65535) ** 2 - 0.6 * np.linspace(0, 1, len(up_and_down))
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(vbat))
    thrust: Array = noise + np.polyval((-3.1e-4, 9.6e-3, 4.5e-3, 2.1e-3), up_and_down / 65535 * vbat)
    found = compare_thrust(frame(up_and_down, vbat_v=vbat, thrust_n=thrust))
    page = look(voltage_figure(found))
    for panel, x in (("(a)", found.motor_volts), ("(b)", found.command)):
        assert np.array(_line(page.panel(panel), "points")) == pytest.approx(np.array([x, found.value]))
    for panel, rms in (("(c)", found.voltage_rms), ("(d)", found.command_rms)):
        axes = page.panel(panel)
        errors = [line.get_ydata()[0] for line in axes.get_lines() if line.get_label() == "± error of prediction"]
        assert errors == pytest.approx([-rms, rms])
        assert f"{rms:.2g} N rms" in axes.get_title(loc="left")
    assert page.panel("(c)").get_ylim() == page.panel("(d)").get_ylim()
    assert found.lines[0][1:] in _written(page)
    assert page.overlapping() == []


# Spectra


@pytest.mark.parametrize(
    ("speed_hz", "marked"), [(53.0, ["1x 53 Hz", "2x 106 Hz", "4x 212 Hz"]), (90.0, ["1x 90 Hz", "2x 180 Hz"])]
)
def test_the_lines_of_a_rotor_are_marked_as_far_as_the_spectrum_reaches(
    look: Look, speed_hz: float, marked: list[str]
) -> None:
    time_s = np.arange(0.0, 4.0, 1 / RATE_HZ)
    force_n = np.zeros((len(time_s), 3))
    force_n[:, 2] = 0.2 * np.sin(2 * np.pi * speed_hz * time_s) + 1e-3 * np.random.default_rng(2).normal(
        size=len(time_s)
    )
    record = WrenchRecord(
        path=Path("forces.csv"),
        source=Source("forces.csv", 64 * "0"),
        label=Label(),
        time_s=time_s,
        force_n=force_n,
        torque_nm=np.zeros_like(force_n),
        status=None,
        findings=(),
    )
    page = look(rotor_figure(record, (1.0, 3.0), speed_rad_per_s=2 * np.pi * speed_hz, title="forces"))
    amplitude, *lines = page.panel("amplitude").get_lines()
    assert [line.get_label() for line in lines] == marked
    assert lines[0].get_xdata()[0] == pytest.approx(speed_hz)
    assert max(amplitude.get_ydata()) == pytest.approx(0.2, rel=0.05)
    assert not page.overlapping()
