"""A campaign's own template is a target too; what others wrote into one reaches no file."""

import json
import os
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import TemplateError

from cfid.errors import DataError
from cfid.export.derived import Derived, Motor
from cfid.export.render import rendered
from cfid.export.target import Target, target_named
from tests.export.reading import TARGETS
from tests.export.thesis_vehicle import vehicle
from tests.lab import ROOT, Cfid

HEAD = """{#
about = "Robot of our own"
file_name = "robot.yaml"
needs = ["mass_kg", "inertia.matrix_kg_m2"]
uses = ["drag"]
#}
"""


def write(campaign: Path, body: str, head: str = HEAD) -> None:
    (campaign / "exports").mkdir(exist_ok=True)
    (campaign / "exports" / "mine.j2").write_text(head + body)


def in_this_process(campaign: Path) -> Target:
    """Return the campaign's template as a target that is rendered here, which is quicker than in a process."""
    return target_named("mine", campaign).model_copy(update={"own": False})


def test_a_template_in_the_campaign_is_exported_by_its_name_in_the_targets_axes(cfid: Cfid, campaign: Path) -> None:
    write(campaign, 'mass: {{ v["mass_kg"]|n }}\nroll: {{ v.inertia_kg_m2[0][0]|n }}\ndrag: {{ v.has("drag") }}\n')
    ended = cfid("export", "mine")

    assert ended.returncode == 0, ended.stderr
    text = (campaign / "exports" / "robot.yaml").read_text()
    assert text.startswith("# Robot of our own: Crazyflie 2.0, ")
    assert text.endswith("\nmass: 0.028\nroll: 1.6655602e-05\ndrag: True\n")
    rows = json.loads(cfid("export", "list", "--json").stdout)["targets"]
    assert [row["ready"] for row in rows if row["target"] == "mine"] == [True]


@pytest.mark.parametrize("key", ["inertia.matrix_kg_m2", "drag.simple_kg_per_rad"])
def test_it_gets_no_quantity_in_the_axes_of_the_campaign(cfid: Cfid, campaign: Path, key: str) -> None:
    write(campaign, f'turned: {{{{ v["{key}"] }}}}\n')
    ended = cfid("export", "mine", "--out", "-")

    assert (ended.returncode, ended.stdout) == (4, "")


def test_the_template_of_the_how_to_is_exported(cfid: Cfid, campaign: Path) -> None:
    page = (ROOT / "docs/how-to/add-an-export.md").read_text()
    (campaign / "exports").mkdir()
    (campaign / "exports" / "mine.j2").write_text(
        textwrap.dedent(page[page.index("        {#") : page.index("    `needs`")])
    )
    ended = cfid("export", "mine", "--out", "-")
    assert ended.returncode == 0, ended.stderr
    lines = [line.partition("  #")[0] for line in ended.stdout.splitlines() if not line.startswith("#")]
    robot = dict(line.split(": ") for line in lines if line)

    assert list(robot) == ["mass", "inertia", "motor1", "motor2", "motor3", "motor4", "lag"]
    assert json.loads(robot["motor1"]) == pytest.approx([0.0325269, -0.0325269, 0], rel=1e-5)


def test_it_reads_no_quantity_that_its_head_does_not_state_since_that_was_not_judged(campaign: Path) -> None:
    for body in ('{{ v["motor.max_thrust_n"] }}', "{{ v.moment_per_thrust_m }}"):
        write(campaign, body)
        with pytest.raises(DataError):
            rendered(in_this_process(campaign), vehicle())


@pytest.mark.parametrize(
    "body",
    [
        "{% include '/etc/passwd' %}",
        "{{ v.__class__.__mro__ }}",
        "{{ v._vehicle.frame }}",
        "{{ ''.__class__.__base__.__subclasses__() }}",
        "{{ v.inertia_kg_m2.tofile('stolen') }}",
        "{{ v.inertia_kg_m2.append(1) }}",
        "{{ open('/etc/passwd').read() }}",
        "{{ v.unknown }}",
    ],
)
def test_a_template_reaches_nothing_but_numbers(body: str, campaign: Path) -> None:
    write(campaign, body)

    with pytest.raises((TemplateError, DataError)):
        rendered(in_this_process(campaign), vehicle())


@pytest.mark.parametrize(
    ("body", "place"),
    [
        ("\n\n{{ 1 / 0 }}", "mine.j2, line 9:"),
        ("\n{% for", "mine.j2, line 8:"),
    ],
    ids=["error", "syntax"],
)
def test_a_template_that_is_wrong_is_named_with_the_line(body: str, place: str, cfid: Cfid, campaign: Path) -> None:
    write(campaign, body)
    ended = cfid("export", "mine")

    assert (ended.returncode, ended.stdout) == (2, "")
    assert place in ended.stderr
    assert sorted(path.name for path in (campaign / "exports").iterdir()) == ["mine.j2"]


@pytest.mark.parametrize(
    "head",
    [
        "",
        "{# about = #}",
        HEAD.replace("robot.yaml", "../rig.toml"),
        HEAD.replace("robot.yaml", "cfid_platform_defaults.h"),
        HEAD.replace("robot.yaml", "other.j2"),
        HEAD.replace("mass_kg", "mass_g"),
        HEAD.replace("uses", "use"),
        "{# " + "a." * 3000 + "b = 1 #}",
    ],
)
def test_an_invalid_head_is_refused(head: str, cfid: Cfid, campaign: Path) -> None:
    write(campaign, "", head)
    (campaign / "exports" / "bytes.j2").write_bytes(b"{# \xff #}")
    for name in ("mine", "bytes"):
        ended = cfid("export", name)
        assert ended.returncode == 2
        assert ".j2: " in ended.stderr
    listed = cfid("export", "list", "--json")
    assert (listed.returncode, listed.stderr.count(".j2: ")) == (0, 2)
    assert [row["target"] for row in json.loads(listed.stdout)["targets"]] == list(TARGETS)


def test_a_head_cannot_claim_that_it_is_cfids_own(campaign: Path) -> None:
    write(campaign, "", HEAD.replace("uses", "own = false\nname = 'firmware'\nuses"))
    target = target_named("mine", campaign)

    assert (target.own, target.name) == (True, "mine")


def test_a_template_does_not_take_the_place_of_a_target_or_of_what_a_campaign_keeps(cfid: Cfid, campaign: Path) -> None:
    write(campaign, "")
    (campaign / "exports" / "firmware.j2").write_text(f"{HEAD}stolen\n")
    assert "CF_MASS" in cfid("export", "firmware", "--out", "-").stdout
    assert "firmware.j2" in cfid("export", "list").stderr
    (campaign / "exports" / "firmware.j2").unlink()

    os.mkfifo(campaign / "exports" / "pipe.j2")
    assert cfid("export", "list").returncode == 0
    assert cfid("export", "pipe").returncode == 2
    assert cfid("export", "../exports/mine").returncode == 2
    assert cfid("export", "other").returncode == 2


def test_templates_get_plain_numbers_alone() -> None:
    """A NumPy array or scalar has a method that writes a file."""
    numbers = Derived(vehicle())

    def plain(value: Any) -> bool:
        if isinstance(value, list | dict | Motor):
            return all(map(plain, value.values() if isinstance(value, dict) else value))
        return type(value) in {int, float, str}

    names = [name for name in dir(Derived) if not name.startswith("_") and not callable(getattr(Derived, name))]
    assert len(names) > 30
    for name in names:
        assert plain(getattr(numbers, name)), name
    calls = (numbers.rest_inertia_kg_m2(10), numbers.rotor_moments_kg_m2(10), numbers.volts(0.05), numbers["drag"])
    assert all(map(plain, calls))
    assert plain(numbers.turned_tensor(np.eye(3).tolist()))
