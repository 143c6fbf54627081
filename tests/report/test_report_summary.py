"""The first screen shows the measured numbers with uncertainties, the main findings, and the next step."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from cfid.findings import finding, note, rejection, warning
from cfid.guide.certainty import Certainty, percent
from cfid.guide.plan import Task
from cfid.guide.status import TaskStatus, next_of
from cfid.quantities.registry import Aim
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section, Source
from cfid.report.experiments import Experiment
from cfid.report.summary import FirstScreen, summary_of
from tests.lab import values_of

NOW = datetime(2026, 1, 1, tzinfo=UTC)
EXPERIMENT = Experiment(
    name="thrust", title="Thrust", command="fit thrust", method="default", found=NOW, cfid_version="", accepted=True,
    findings=(), parameters=(), tables=(), lines=(), figures=(), notes=(), sources=(),
)  # fmt: skip


def section(**parameters: Parameter) -> Section:
    named = {key.replace("__", "."): value for key, value in parameters.items()}
    return Section(method="default", found=NOW, cfid_version="", accepted=True, sources=(), parameters=named)


def summary(*sections: Section, experiments: tuple[Experiment, ...] = (), stds: tuple[float, ...] = ()) -> FirstScreen:
    known = values_of({str(i): one for i, one in enumerate(sections)})
    found = tuple(Certainty(key=f"number {i}", aim=Aim(0.03, "a purpose: 3 %"), std=std) for i, std in enumerate(stds))
    task = Task(section="thrust", recordings=(), fit=("fit", "thrust"), aims=())
    status = TaskStatus(task=task, lacking=(), state="not fitted", reason="recorded.", found=found)
    return summary_of(known, experiments, [status], next_of([status]))


def test_numbers_are_in_plain_units_with_their_relative_uncertainty() -> None:
    most = Parameter(value=0.1683, std=0.0011, unit="N")
    inertia = [[16.42e-6, 0, 0], [0, 16.9e-6, 0], [0, 0, 28.9e-6]]
    matrix = Parameter(value=inertia, std=[[2.4e-8] * 3] * 3, unit="kg m^2")
    numbers = {
        one.title: one for one in summary(section(motor__max_thrust_n=most, inertia__matrix_kg_m2=matrix)).numbers
    }

    assert numbers["Mass"].value == "28.000 ± 0.030 g"
    assert (numbers["Largest thrust of one motor"].value, numbers["Largest thrust of one motor"].std) == (
        "168.3 ± 1.1 mN",
        "0.65 %",
    )
    assert numbers["Inertia about x"].value == "(16.420 ± 0.024)·10⁻⁶ kg m²"
    assert "Round trip to the vehicle" not in numbers


def test_an_arm_that_was_set_is_shown_in_place_of_that_of_rig_toml() -> None:
    (arm,) = (
        number for number in summary(section(arm_m=Parameter(value=0.05, std=0.001))).numbers if number.title == "Arm"
    )
    assert arm.value == "50.0 ± 1.0 mm"


def test_torque_speed_friction_and_drag_have_a_row_each_in_plain_units() -> None:
    found = section(
        motor__torque_poly=Parameter(value=[0.006, 1e-5], std=[0.0001, 1e-6], unit="Nm(N)"),
        motor__speed_poly=Parameter(value=[0.04, 400.0], std=[0.0, 2.0], unit="rad/s(cmd)"),
        friction__viscous_nms_per_rad=Parameter(value=1.08e-6, std=2.2e-8, unit="N m s/rad"),
        drag__simple_kg_per_rad=Parameter(value=[-8.5e-7, -8e-7, -9e-7], std=[2.6e-8] * 3, unit="kg/rad"),
    )
    numbers = {one.title: (one.value, one.std) for one in summary(found).numbers}

    assert numbers["Torque over thrust of a rotor, in hover"] == ("6.00 ± 0.10 mN m/N", "1.7 %")
    assert numbers["Rotor speed at command 30000"] == ("1600.0 ± 2.0 rad/s", "0.12 %")
    assert numbers["Viscous friction of the axis"] == ("(1.080 ± 0.022)·10⁻⁶ N m s/rad", "2 %")
    assert numbers["Drag along x, over speeds of rotors and wind"][0] == "(-0.850 ± 0.026)·10⁻⁶ kg/rad"
    assert numbers["Drag along y, over speeds of rotors and wind"][1] == "3.2 %"  # the least certain, as in status


def test_the_uncertainty_of_a_speed_takes_that_coefficients_move_together() -> None:
    values = {"motor.speed_poly": [0.04, 400.0]}
    together = covariance_between(values, np.outer([1e-4, -3.0], [1e-4, -3.0]))  # the line turns about command 30000
    one = section(motor__speed_poly=Parameter(value=[0.04, 400.0], std=[1e-4, 3.0], unit="rad/s(cmd)"))
    (shown,) = (
        number.value for number in summary(replace(one, covariance=together)).numbers if "speed" in number.title
    )

    assert shown == "1600 rad/s"


def test_a_rejected_number_is_named_and_not_printed() -> None:
    found = section(motor__max_thrust_n=Parameter(value=0.1683, std=0.0011, unit="N"))
    shown = summary(replace(found, rejected={"motor.max_thrust_n": "it scatters"})).numbers

    assert [one.value for one in shown if "thrust" in one.title] == ["rejected"]


@pytest.mark.parametrize(("stds", "told"), [((), ""), ((0.01, 0.02), "enough for"), ((0.01, 0.06), "too little for")])
def test_the_weakest_number_is_that_furthest_from_what_it_is_for(stds: tuple[float, ...], told: str) -> None:
    weakest = summary(stds=stds).weakest

    assert told in weakest
    assert weakest.startswith("number 1" if stds else "")


def test_a_number_within_its_uncertainty_of_zero_is_said_to_be() -> None:
    viscous = Parameter(value=1.6e-6, std=5.3e-6, unit="N m s/rad")
    numbers = summary(section(friction__viscous_nms_per_rad=viscous)).numbers
    (number,) = [one for one in numbers if "friction" in one.title]

    assert number.std == "consistent with zero"
    assert (percent(3.2), percent(0.0032), percent(None)) == ("320 %", "0.32 %", "-")


def test_warnings_of_results_come_before_those_of_recordings() -> None:
    findings = (warning("recording", "run: 12 samples were lost."), warning("a", "it wanders."))

    assert summary(experiments=(replace(EXPERIMENT, findings=findings),)).findings == (
        "Thrust: it wanders.",
        "Thrust: run: 12 samples were lost.",
    )


def test_rejections_come_before_warnings_each_sentence_once_and_notes_stay_below() -> None:
    warned = replace(EXPERIMENT, findings=(warning("a", "it wanders."), note("b", "a detail.")))
    rejected = replace(
        EXPERIMENT, title="Torque", findings=(rejection("c", "it is noise.", "x"), warning("a", "it wanders."))
    )
    simulated = replace(EXPERIMENT, findings=(finding("recording-simulated").at("a run"),))

    assert summary(experiments=(warned, rejected, simulated)).findings == (
        "Torque: it is noise.",
        "Thrust, Torque: it wanders.",
    )


def test_a_fit_whose_recordings_a_later_one_took_too_has_no_say_there() -> None:
    wanders, noisy = warning("a", "it wanders."), warning("b", "it is noisy.")
    earlier = replace(EXPERIMENT, title="Thrust, earlier", findings=(wanders,), sources=(Source("1", "a"),))
    other = replace(earlier, title="Thrust, another", sources=(Source("3", "c"),))
    both = (Source("1", "a"), Source("2", "b"))
    later = replace(EXPERIMENT, findings=(noisy,), sources=both, found=NOW + timedelta(hours=1))

    assert summary(experiments=(later, earlier, other)).findings == (
        "Thrust: it is noisy.",
        "Thrust, another: it wanders.",
    )


def test_to_fit_again_is_not_advised_where_a_later_fit_was_accepted() -> None:
    again = rejection("stale", "Fitted to runs that are now excluded: a: fit again without them.")
    earlier = replace(EXPERIMENT, title="Thrust, earlier", findings=(again,), sources=(Source("1", "a"),))
    later = replace(EXPERIMENT, sources=(Source("2", "b"),), found=NOW + timedelta(hours=1))
    refused = replace(later, accepted=False, findings=(rejection("a", "it wanders."),))
    of_another = replace(later, name="torque")

    assert summary(experiments=(later, earlier)).findings == ()
    assert f"Thrust, earlier: {again.sentence}" in summary(experiments=(refused, earlier)).findings
    assert f"Thrust, earlier: {again.sentence}" in summary(experiments=(of_another, earlier)).findings


def test_five_findings_are_shown_and_the_others_counted() -> None:
    seven = replace(EXPERIMENT, findings=tuple(warning("a", f"it wanders {i} times.") for i in range(7)))
    shown, none = summary(experiments=(seven,)), summary()

    assert (len(shown.findings), shown.more_findings) == (5, 2)
    assert none.more_findings == 0


def test_what_comes_next_is_the_guides_own_answer(tmp_path: Path) -> None:
    assert summary().next_command == "cfid fit thrust"


def test_a_report_in_which_everything_is_found_does_not_advise_a_report() -> None:
    done = summary_of(values_of({}), (), (), next_of(()))
    assert done.next_command == "cfid export"
    assert done.next_why.startswith("everything is found, and sure enough.")


def test_the_weakest_number_has_the_largest_part_of_its_uncertainty() -> None:
    found = Certainty(key="drag.simple_kg_per_rad", aim=Aim(0.2, "a simulator"), std=0.03, mostly="gain")
    task = Task(section="drag", recordings=(), fit=("fit", "drag"), aims=())
    status = TaskStatus(task=task, lacking=(), state="accepted", reason="", found=(found,))

    assert summary_of(values_of({}), (), [status], next_of([status])).weakest.endswith(
        " is known to 3 % (mostly by the gain), enough for a simulator."
    )


def test_losses_of_accepted_fits_are_one_sentence_and_the_last() -> None:
    lost = [
        finding("samples-not-taken", samples=f"{n} samples were", achieved="99 %").at(f"run {n}") for n in range(2, 8)
    ]
    lossy = replace(EXPERIMENT, findings=(*lost, finding("recording-cut", or_grows="").at("run 1")))
    refused = replace(EXPERIMENT, title="Torque", accepted=False, findings=(lost[0],))

    assert summary(experiments=(lossy, refused)).findings == (
        "Thrust: the run was cut; the rows on disk are used.",
        f"Torque: {lost[0].sentence}",
        "Thrust: 6 recordings lost samples or missed some; the fits are accepted nevertheless.",
    )
