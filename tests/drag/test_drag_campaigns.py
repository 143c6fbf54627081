"""The thesis' wind campaign: its 112 runs and its table of experiments, which the tests of drag share."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, SIMPLE, DragModel
from cfid.drag.wind.frames import std_turned_about_z
from cfid.drag.wind.plan import THESIS_WINDS, WindSetting, missing_lines, missing_runs, thesis_plan
from cfid.drag.wind.reduction import WindForce, reduce_forces
from cfid.motors.points import rotor_speed_rad_s
from cfid.recordings.wrench import turn_about_z
from cfid.sim.loadcell import LoadCellTruth
from tests.drag.wind_tunnel import (
    Air,
    ComplexAir,
    CrossAir,
    SimpleAir,
    Tunnel,
    TunnelRun,
    Wind,
    known_to,
    simulate_campaign,
)

Array = npt.NDArray[np.float64]

EQ_4_8 = np.array([-9.1785e-7, -9.1785e-7, -10.311e-7])
EQ_4_9 = np.array(
    [
        [-8.9158e-7, -8.9158e-7, -3.1574e-7],
        [-6.8572e-5, -6.8572e-5, 5.2068e-5],
        [1.1254e-10, 1.1254e-10, -2.3662e-10],
        [-5.4233e-4, -5.4233e-4, -2.2935e-3],
        [-1.8443e-6, -1.8443e-6, 4.8857e-7],
        [6.4061e-3, 6.4061e-3, 3.0985e-3],
    ]
)
EQ_4_11 = 1e-7 * np.array([[-10.2506, -0.3177, -0.4332], [-0.3177, -10.2506, -0.4332], [-7.7050, -7.7050, -7.5530]])

SIMPLE_AIR = SimpleAir(kg_per_rad=EQ_4_8.tolist())
COMPLEX_AIR = ComplexAir(k=EQ_4_9)
CROSS_AIR = CrossAir(kg_per_rad=EQ_4_11)
WORLDS: tuple[tuple[Air, DragModel, Array], ...] = (
    (SIMPLE_AIR, SIMPLE, EQ_4_8),
    (COMPLEX_AIR, COMPLEX, EQ_4_9),
    (CROSS_AIR, CROSS, EQ_4_11),
)
NAMES = tuple(model.name for _, model, _ in WORLDS)

EXACT = LoadCellTruth(noise_std=(0,) * 6, drift_per_s=(0,) * 6)
WINDS = [Wind(setting.angle_deg or 0.0, setting.min_mps, setting.max_mps) for setting in THESIS_WINDS]


def as_typed(runs: Sequence[TunnelRun], *, yaw_deg: float = 45.0) -> list[WindForce]:
    """Return simulated runs as an operator states them: with names, and references without an angle."""
    return [
        WindForce(
            name=f"run {i}",
            command=run.command,
            setting=WindSetting(
                angle_deg=None if run.max_mps == 0 else run.angle_deg,
                min_mps=run.min_mps,
                max_mps=run.max_mps,
                azimuth_deg=math.degrees(run.azimuth_rad),
            ),
            force_n=turn_about_z(run.force_n, yaw_deg=yaw_deg),
            force_std_n=std_turned_about_z(run.force_std_n, yaw_deg=yaw_deg),
            rotor_rad_s=float(rotor_speed_rad_s(run.shown_rpm, markers=2)),
        )
        for i, run in enumerate(runs)
    ]


def exact_runs(air: Air, winds: Sequence[Wind] = WINDS) -> list[WindForce]:
    """Return the thesis' campaign without noise, in winds that are exactly the middle of their readings."""
    tunnel = Tunnel(air=air, cell=EXACT, unsteady=0.0)
    return as_typed(simulate_campaign(tunnel, known_to(0.0, winds), rng=np.random.default_rng(0)))


def exact(air: Air, winds: Sequence[Wind] = WINDS) -> DragExperiments:
    return reduce_forces(exact_runs(air, winds))


def measured_runs(air: Air, rng: np.random.Generator, winds: Sequence[Wind] = WINDS) -> list[WindForce]:
    """Return a campaign with noise, drift, and wind that is inhomogeneous and known to 5 %."""
    return as_typed(simulate_campaign(Tunnel(air=air), known_to(0.05, winds), rng=rng))


def measured(air: Air, rng: np.random.Generator, winds: Sequence[Wind] = WINDS) -> DragExperiments:
    return reduce_forces(measured_runs(air, rng, winds))


def test_the_plan_is_that_of_section_4_4_2() -> None:
    plan = thesis_plan()

    assert len(plan) == len(set(plan)) == 112
    assert sum(run.angle_deg is None for run in plan) == 7
    assert {run.fan_v for run in plan} == {0, 5, 6, 8, 10, 12}
    assert np.mean([(wind.min_mps + wind.max_mps) / 2 for wind in THESIS_WINDS]) == pytest.approx(2.85)


def test_missing_runs_are_in_the_order_of_the_plan_and_others_do_not_count() -> None:
    plan = thesis_plan()
    another = plan[5]._replace(command=12345)

    assert missing_runs([]) == plan
    assert missing_runs([*plan, another, plan[0]]) == ()
    assert missing_runs([plan[5], plan[0], plan[0], another], plan[:7]) == (*plan[1:5], plan[6])


def test_missing_runs_are_printed_a_line_a_setting_with_their_commands() -> None:
    plan = thesis_plan()

    assert missing_lines(plan) == ["all 112 runs of the thesis' plan are recorded."]
    assert missing_lines([*plan[:7], plan[8], *plan[14:]]) == [
        "of the thesis' 112 runs 106 are recorded, missing are:",
        "  0 deg, 5 V      0, 20000, 30000, 37300, 40000, 50000",
    ]
    assert missing_lines(plan[7:])[1] == "  no wind         all commands"


def test_the_campaign_is_90_experiments_in_15_winds_with_the_thesis_means() -> None:
    experiments = exact(SIMPLE_AIR)

    assert experiments.force_n.shape == (90, 3)
    assert experiments.settings == 15
    assert experiments.wind_mps.mean() == pytest.approx(2.85)
    assert experiments.speed_sum_rad_s.mean() == pytest.approx(5992.7, abs=0.05)
