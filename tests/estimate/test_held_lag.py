"""Values that follow held ones with a lag, compared with a recursion through all steps."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.estimate.held_lag import follow_held

Array = npt.NDArray[np.float64]


def stepped(to: Array, rising: Array, falling: Array) -> Array:
    late = [to[0]]
    for value, up, down in zip(to[:-1], rising, falling, strict=True):
        late.append(value + (late[-1] - value) * (up if value > late[-1] else down))
    return np.array(late)


@pytest.mark.parametrize("held", [1, 4, 30])
def test_what_follows_several_held_values_is_what_each_one_s_steps_add_up_to(held: int) -> None:
    rng = np.random.default_rng(held)
    to = np.repeat(rng.uniform(0.2, 0.8, (4, 600)), held, axis=1)
    to[3] = 0.5  # one that never changes
    rising, falling = rng.uniform(0.9, 0.99, (2, to.shape[1] - 1))

    late = follow_held(to, rising, falling)

    assert np.abs(late - [stepped(row, rising, falling) for row in to]).max() < 1e-14
