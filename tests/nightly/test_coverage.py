"""A row of the nightly table of which every fit has to be right."""

from tests.nightly.coverage import ROWS, measure


def test_steps_of_a_speed_that_wanders_are_given_within_their_uncertainty() -> None:
    wandering = next(place for place, row in enumerate(ROWS) if row.name == "steps: speed wanders")
    found = measure(wandering, 4)

    assert not found["rejected"]
    assert len(found["numbers"]) == 3
    assert all(abs(value - true) < 3 * std < 0.5 * true for true, value, std in found["numbers"].values())
