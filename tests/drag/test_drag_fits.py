"""Drag from recordings and tables: `cfid fit drag`, and `cfid.drag.fit` for a notebook."""

import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid import drag
from cfid.drag.comparison import Method
from cfid.drag.data import WindReading
from cfid.drag.model import COMPLEX, CROSS, SIMPLE, DragExperiments, DragModel
from cfid.drag.thesis import Grouping
from cfid.errors import DataError
from cfid.records.rig_file import RigFacts, WindStand
from tests.drag.thesis_campaign import COMPLEX_AIR, EQ_4_11, NAMES, SIMPLE_AIR, WORLDS, exact, measured
from tests.drag.wind_in_a_folder import (
    DRIVEN,
    EQ_4_8,
    HEAD,
    MOUNT,
    STILL,
    WINDS,
    Row,
    Spoil,
    WindFolder,
    name_of,
    recorded,
)
from tests.drag.wind_tunnel import CrossAir, Wind
from tests.lab import Cfid, new_campaign

Array = npt.NDArray[np.float64]

TABLE = "command,angle_deg,vx_mps,vy_mps,vz_mps,speed_sum_rad_s,fx_n,fy_n,fz_n"
ON_THE_THESIS_RIG = ("--geometry", "thesis")
GROUPS = [("each", 90), ("lateral", 90), ("command", 12)]


@pytest.fixture(scope="module")
def unspoilt(tmp_path_factory: pytest.TempPathFactory) -> WindFolder:
    return recorded(tmp_path_factory.mktemp("tunnel"))


@pytest.fixture
def tunnel(unspoilt: WindFolder, tmp_path: Path) -> WindFolder:
    shutil.copytree(unspoilt.folder, tmp_path, dirs_exist_ok=True)
    return WindFolder(tmp_path, [dict(row) for row in unspoilt.rows])


def read(index: Path, *, method: Method = "default", **wind: float) -> DragExperiments:
    given = RigFacts(wind=WindStand(**wind))
    return drag.read_index(index, how=WindReading(method, given, MOUNT))


def write_table(path: Path, experiments: DragExperiments) -> Path:
    e = experiments
    rows = np.column_stack([e.command, e.angle_deg, e.velocity_mps, e.speed_sum_rad_s, e.force_n])
    np.savetxt(path, rows, delimiter=",", header=TABLE, comments="", fmt="%.12g")
    return path


def fitted(ended: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert ended.returncode == 0, ended.stderr
    content: dict[str, Any] = json.loads(ended.stdout)
    return content


# Results


def test_an_index_of_recordings_gives_the_coefficients_that_act(cfid: Cfid, tunnel: WindFolder) -> None:
    found = fitted(cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", tunnel.write(), "--json"))

    simple = found["parameters"]["drag.simple_kg_per_rad"]
    assert simple["unit"] == "kg/rad"
    assert np.all(np.abs(np.array(simple["value"]) - EQ_4_8) < 3 * np.array(simple["std"]))
    assert np.all(np.array(simple["std"]) < 0.1 * np.abs(EQ_4_8))
    assert found["command"] == "fit drag"
    assert found["accepted"]
    assert found["quality"]["experiments"] == 2 * len(WINDS)
    assert len(found["sources"]) == 1 + len(tunnel.rows)
    assert all(set(parameter) == {"value", "std", "unit"} for parameter in found["parameters"].values())


@pytest.mark.parametrize(("air", "model", "printed"), WORLDS, ids=NAMES)
def test_forces_of_a_table_give_the_printed_coefficients_back_to_six_digits(
    tmp_path: Path, air: Any, model: DragModel, printed: Array
) -> None:
    result = drag.fit(drag.read_forces(write_table(tmp_path / "forces.csv", exact(air))))
    found = result.quantities

    keys = {
        SIMPLE: ["drag.simple_kg_per_rad"],
        COMPLEX: [f"drag.complex.k{i}" for i in range(1, 7)],
        CROSS: ["drag.cross_coupling_kg_per_rad"],
    }[model]
    assert np.squeeze([found[key].value for key in keys]) == pytest.approx(printed, rel=5e-7)
    assert found[f"drag.sse_n2.{model.name}"].value < 1e-15
    assert result.quality["chosen"] == model.name
    assert result.accepted


@pytest.mark.parametrize(("grouping", "count"), GROUPS)
def test_the_thesis_method_groups_as_c_3_1_and_its_means_are_exact(grouping: Grouping, count: int) -> None:
    found = drag.fit(exact(SIMPLE_AIR), method="thesis", grouping=grouping).quantities

    assert found["drag.simple_kg_per_rad"].value == pytest.approx(EQ_4_8, rel=5e-7)
    rows = found["drag.groups"].value
    assert len(rows) == count
    values = np.array([row["x_kg_per_rad" if grouping == "each" else "kg_per_rad"] for row in rows])
    from_the_side = np.isfinite(values)
    assert from_the_side.sum() == min(count, 60)  # wind from above does not determine x and y
    assert values[from_the_side] == pytest.approx(EQ_4_8[0])


def test_kappa_4_is_unresolved_from_one_azimuth_and_resolved_from_two(tmp_path: Path) -> None:
    mended = CrossAir(kg_per_rad=EQ_4_11, mended=True)
    turned = [wind._replace(azimuth_rad=wind.azimuth_rad + 2.0) for wind in WINDS[1:]]
    both = recorded(tmp_path, air=mended, winds=[*WINDS, *turned])
    head = (*HEAD, "azimuth_deg")
    two = drag.fit([], index=both.write(head=head), rig=MOUNT, mended=True)
    both.rows = [row for row in both.rows if row["azimuth_deg"] in ("", row_azimuth(both))]
    one = drag.fit([], index=both.write(head=head), rig=MOUNT, mended=True)

    assert one.quality["unresolved"] == ("kappa_4",)
    assert one.quality["kappa_4_times"] == "|v_xy|"
    assert two.quality["unresolved"] == ()
    matrix = two.quantities["drag.cross_coupling_kg_per_rad"]
    assert abs(matrix.value[2, 0] - EQ_4_11[2, 0]) < 3 * matrix.std[2, 0]


def row_azimuth(tunnel: WindFolder) -> str:
    return tunnel.row(DRIVEN[0], WINDS[1])["azimuth_deg"]


def test_a_model_that_is_not_determined_is_rejected_without_the_others() -> None:
    experiments = exact(COMPLEX_AIR)
    result = drag.fit(experiments.at(experiments.wind_mps < 2.3))
    few = drag.fit(experiments.at(np.isin(experiments.setting, (5, 10))))

    assert result.accepted
    assert "drag.complex.k1" in result.quantities
    assert few.accepted
    assert {"drag.simple_kg_per_rad", "drag.sse_n2.simple"} <= few.without_rejected().quantities.keys()
    (finding,) = (one for one in few.findings if one.code == "drag-not-determined")
    assert finding.quantities == ("drag.complex.*", "drag.*.complex")
    assert "of 12 unknowns of the complex model" in finding.text


def test_the_thesis_method_takes_the_tare_of_the_first_500_samples(tmp_path: Path) -> None:
    tunnel = recorded(tmp_path)
    for row in tunnel.rows:
        row |= {"from_s": "4", "to_s": "5.5"}
    index = tunnel.write(head=(*HEAD, "from_s", "to_s"))
    ours, thesis = read(index), read(index, method="thesis")

    assert ours.force_n != pytest.approx(thesis.force_n, rel=1e-9)
    assert ours.force_n == pytest.approx(thesis.force_n, abs=0.004)


# The command


def test_a_campaign_keeps_the_result_and_its_figures(cfid: Cfid, tunnel: WindFolder) -> None:
    new_campaign(tunnel.folder)
    ended = cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", tunnel.write())

    assert ended.returncode == 0, ended.stderr
    assert "drag.simple_kg_per_rad" in (tunnel.folder / "parameters.toml").read_text()
    names = {path.name for path in (tunnel.folder / "figures").iterdir()}
    assert {"drag_forces.png", "drag_models.svg", "drag_coefficients.png"} <= names


def test_a_swapped_file_is_named_with_code_5_and_force_gives_the_numbers(cfid: Cfid, tunnel: WindFolder) -> None:
    exchange(*(tunnel.row(command, WINDS[2]) for command in DRIVEN))
    index = tunnel.write()
    ended = cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", index, "--no-figures", "--json")
    assert ended.returncode == 5, ended.stdout
    assert json.loads(ended.stdout)["parameters"] == {}
    assert "Traceback" not in ended.stderr

    forced = fitted(cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", index, "--no-figures", "--json", "--force"))
    assert not forced["accepted"]
    assert "drag.simple_kg_per_rad" in forced["parameters"]


# Wrong inputs


def exchange(one: Row, other: Row) -> None:
    one["loadcell"], other["loadcell"] = other["loadcell"], one["loadcell"]


def change(at: int, wind: Wind, **fields: str) -> Spoil:
    return lambda tunnel: tunnel.row(at, wind).update(fields)


def spoil_file(text: str) -> Spoil:
    path = name_of(DRIVEN[0], WINDS[1])
    return lambda tunnel: (tunnel.folder / path).write_text(text)


def copy_file(tunnel: WindFolder) -> None:
    copied = tunnel.folder / name_of(DRIVEN[0], WINDS[1])
    (tunnel.folder / name_of(DRIVEN[1], WINDS[1])).write_bytes(copied.read_bytes())


NOISE = "t,Fx_counts,Fy,Fz,Tx,Ty,Tz\n" + "".join(f"{0.0025 * i:.4f},1,2,{i % 7},4,5,6\n" for i in range(2400))
SPOILT: dict[str, tuple[Spoil, str]] = {
    "no lowest wind": (change(20000, WINDS[1], wind_min_mps=""), "wind.csv:9: '' in column 'wind_min_mps'"),
    "no command": (change(20000, WINDS[1], command="70000"), "command is 70000: it should be a whole number"),
    "a missing file": (change(20000, WINDS[1], loadcell="none.csv"), "none.csv: no such file."),
    "a file twice": (change(20000, WINDS[1], loadcell=name_of(40000, WINDS[1])), "is the file of wind.csv:9 too"),
    "a copy of a file": (copy_file, "the same recording as"),
    "a file with nan": (spoil_file(NOISE + "6.0,1,nan,3,4,5,6\n" * 400), ".csv:2402: no number in Fx or Fy"),
    "motors that never ran": (spoil_file(NOISE), "20000.csv: the motors never run in this record"),
    "a window that ends first": (change(20000, WINDS[1], from_s="4", to_s="3"), "a window begins at from_s"),
}


@pytest.mark.parametrize(
    ("axis", "begin", "share", "left"), [("Fy", 0.3, 0.1, 8), ("Fx", 0.3, 0.1, 8), ("Fx", 0.25, 0.75, 7)]
)
def test_a_load_cell_that_was_stuck_costs_its_samples_or_its_file_and_is_named(
    tmp_path: Path, axis: str, begin: float, share: float, left: int
) -> None:
    tunnel = recorded(tmp_path)
    whole = drag.fit([], index=tunnel.write(), rig=MOUNT)
    name = tunnel.row(40000, WINDS[1])["loadcell"]
    table = pd.read_csv(tmp_path / name)
    rows = slice(round(begin * len(table)), round((begin + share) * len(table)))
    table.loc[rows.start : rows.stop - 1, f"{axis}_counts"] = 0 if axis == "Fx" else -1_000_000
    table.to_csv(tmp_path / name, index=False)
    found = drag.fit([], index=tunnel.write(), rig=MOUNT)

    assert "force-stuck" in {one.code for one in found.findings}
    assert ("drag-load-cell-stuck" in {one.code for one in found.findings}) == (left < 8)
    assert f"{left} experiments in" in " ".join(found.summary())
    key = "drag.simple_kg_per_rad"
    std = np.array(whole.quantities[key].std)
    assert np.abs(np.array(found.quantities[key].value) - whole.quantities[key].value).max() < std.max()


@pytest.mark.parametrize(("spoil", "sentence"), SPOILT.values(), ids=SPOILT)
def test_a_wrong_index_or_recording_is_named_with_its_place(tunnel: WindFolder, spoil: Spoil, sentence: str) -> None:
    spoil(tunnel)
    with pytest.raises(DataError, match=re.escape(sentence)):
        read(tunnel.write(head=(*HEAD, "from_s", "to_s")))


@pytest.mark.parametrize(
    ("written", "sentence"),
    [
        ("command,fx_n\n1,2\n", "no column angle_deg, vx_mps"),
        (f"{TABLE}\n10000,0,0,0,3,nan,0,0,-0.01\n", ":2: no number in column 'speed_sum_rad_s'"),
        (f"{TABLE}\n10000,0,0,0,3,-4000,0,0,-0.01\n", ":2: speed_sum_rad_s is -4000: no vehicle has that"),
        (f"{TABLE}\n10000,0,0,0,3,4000,0,0,-1e200\n", ":2: fz_n is -1e+200: no vehicle has that"),
        (f"{TABLE}\n10000,0,0,0,0,4000,0,0,-0.01\n", "no row has both wind and turning rotors"),
    ],
)
def test_a_file_that_is_not_a_table_of_forces_is_refused(tmp_path: Path, written: str, sentence: str) -> None:
    (tmp_path / "forces.csv").write_text(written)
    with pytest.raises(DataError, match=re.escape(sentence)):
        drag.read_forces(tmp_path / "forces.csv")


def test_wrong_options_are_usage_errors_and_a_missing_reference_is_wrong_data(cfid: Cfid, tunnel: WindFolder) -> None:
    index = tunnel.write()
    for options in (("--yaw-deg", "inf"), ("--table", index)):
        ended = cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", index, *options)
        assert (ended.returncode, ended.stdout) == (2, "")
    assert cfid("fit", "drag").returncode == 2
    for command in DRIVEN:
        tunnel.rows.remove(tunnel.row(command, STILL))
    ended = cfid("fit", "drag", *ON_THE_THESIS_RIG, "--index", tunnel.write())
    assert (ended.returncode, ended.stdout) == (4, "")


def test_the_azimuth_of_a_row_stands_before_that_of_an_option(tunnel: WindFolder) -> None:
    given = read(tunnel.write(), azimuth_deg=10)
    for row in tunnel.rows:
        row["azimuth_deg"] = "60" if row["azimuth_deg"] else ""
    of_rows = read(tunnel.write(head=(*HEAD, "azimuth_deg")), azimuth_deg=10)

    for experiments, azimuth_deg in ((given, 10), (of_rows, 60)):
        x, y, _ = experiments.velocity_mps[-1]
        assert math.degrees(math.atan2(-y, x)) == pytest.approx(azimuth_deg)


@pytest.mark.parametrize("yaw_deg", [-45.0, 135.0])
def test_a_vehicle_that_was_turned_the_other_way_is_rejected(tunnel: WindFolder, yaw_deg: float) -> None:
    result = drag.fit([], index=tunnel.write(), rig=MOUNT, yaw_deg=yaw_deg)

    assert "drag-across-wind" in {one.code for one in result.findings}
    assert not result.accepted


def test_intercepts_and_the_bodys_own_drag_are_reported_and_the_complex_model_takes_no_intercepts() -> None:
    found = drag.fit(exact(SIMPLE_AIR), intercepts=True).quantities
    body = drag.fit(exact(SIMPLE_AIR), parasitic=True).quantities["drag.parasitic_kg_per_m.simple"]

    assert found["drag.simple_kg_per_rad"].value == pytest.approx(EQ_4_8, rel=1e-6)
    assert len(found["drag.intercepts_n.simple"].value) == 15
    assert "drag.intercepts_n.complex" not in found
    assert body.value == pytest.approx([0, 0, 0], abs=1e-9)
    assert body.unit == "kg/m"


def test_quantities_have_covariances_that_agree_with_their_uncertainties() -> None:
    result = drag.fit(measured(SIMPLE_AIR, np.random.default_rng(3)))

    assert [one.of for one in result.covariances] == [
        ("drag.simple_kg_per_rad",),
        ("drag.cross_coupling_kg_per_rad",),
    ]
    for one in result.covariances:
        std = np.ravel(result.quantities[one.of[0]].std)
        np.testing.assert_allclose(np.sqrt(np.diag(one.matrix)), std)
