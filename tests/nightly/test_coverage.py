"""The code that makes the nightly table, on the quickest row."""

import json
from pathlib import Path

from tests.nightly.coverage import ROWS, measure, table, turns

SPEED = next(place for place, row in enumerate(ROWS) if row.name == "speed map: ideal")


def test_a_seed_gives_the_same_line_again_and_another_seed_another() -> None:
    first, again, other = (measure(SPEED, seed)["numbers"] for seed in (3, 3, 4))

    assert first == again
    assert first != other
    assert set(first) == {"motor.speed_poly [0]", "motor.speed_poly [1]"}


def test_the_table_states_coverage_with_its_exact_interval_and_what_was_rejected(tmp_path: Path) -> None:
    held = [
        {"row": ROWS[SPEED].name, "numbers": {"k": [2.0, 2.0 + 0.01 * at, 0.01]}, "warnings": []} for at in (1, 1, 5)
    ]
    refused = {"row": ROWS[SPEED].name, "numbers": {}, "warnings": ["a-code"]}
    row = table(json.loads(json.dumps([*held, refused]))).splitlines()[-1]

    assert row == "| speed map: ideal | k | 4 | +1.2 % | 3.00 | 67 % (9 to 99) | 25 % | 25 % | 25 % |"


def test_rows_take_turns_until_each_has_its_fits() -> None:
    found = [(ROWS[place].name, seeds) for place, seeds in turns("speed map", 30)]
    names = [row.name for row in ROWS if row.name.startswith("speed map")]

    assert found == [(name, seeds) for seeds in (range(20), range(20, 30)) for name in names]


def test_steps_of_a_speed_that_wanders_are_given_within_their_uncertainty() -> None:
    wandering = next(place for place, row in enumerate(ROWS) if row.name == "steps: speed wanders")
    found = measure(wandering, 4)

    assert not found["rejected"]
    assert len(found["numbers"]) == 3
    assert all(abs(value - true) < 3 * std < 0.5 * true for true, value, std in found["numbers"].values())
