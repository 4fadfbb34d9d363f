"""What an input does between rows: chosen from its values, said by the user, the same always."""

import numpy as np
import pytest

from dynsr.data import Trajectory, take_trajectories
from dynsr.data.holding import choose_hold, holds_its_value
from dynsr.data.trajectory import decide_hold
from dynsr.errors import InputError

ROWS = 240
T = np.arange(float(ROWS))


def in_steps(rng: np.random.Generator, fewest: int, most: int, levels: int | None) -> np.ndarray:
    """Give values that are each held for some rows; of any size where there are no levels."""
    values: list[float] = []
    while len(values) < ROWS:
        level = rng.uniform() if levels is None else float(rng.integers(levels))
        values += [level] * int(rng.integers(fewest, most + 1))
    return np.array(values[:ROWS])


RNG = np.random.default_rng(0)
HELD = {
    "a heater": in_steps(RNG, 12, 12, 5),
    "any value for 7 to 15 rows": in_steps(RNG, 7, 15, None),
    "a valve that changes every 1 to 3 rows": in_steps(RNG, 1, 3, 2),
    "a level every row": in_steps(RNG, 1, 1, 5),
    "a staircase": np.floor(T / 24),
    "one step": (T > 100) * 1.0,
    "a pulse": ((T > 100) & (T < 104)) * 1.0,
    "doses": (RNG.uniform(size=ROWS) < 0.05) * 5.0,
    "a controller's output": np.repeat(np.cumsum(RNG.normal(size=ROWS // 5)), 5),
    "a constant": np.full(ROWS, 3.0),
}
LINEAR = {
    "a ramp": 0.3 * T,
    "a triangle": np.abs(T % 40 - 20),
    "ramps and pauses": np.clip(np.abs(T % 60 - 30) - 8, 0, 15),
    "a rounded temperature": np.round(
        10 + 5 * np.sin(T / 38) + np.cumsum(0.1 * RNG.normal(size=ROWS)), 1
    ),
    "a noisy sine": np.sin(T / 20) + 0.05 * RNG.normal(size=ROWS),
    "a random walk": np.cumsum(RNG.normal(size=ROWS)),
}
SMOOTH = {
    "a sine": np.sin(T / 8),
    "a sine of five rows": np.sin(1.2 * T),
    "a rounded sine": np.round(np.sin(T / 8), 2),
    "a transient that ends": np.round(1 - np.exp(-T / 10), 6),
    "a smooth pulse": np.exp(-(((T - 100) / 8) ** 2)),
    "a chirp": np.sin((T / 20) ** 2 / 2),
    "a parabola": (T / 100) ** 2,
}
WAYS = {"previous": HELD, "linear": LINEAR, "smooth": SMOOTH}


@pytest.mark.parametrize(
    ("way", "name"), [(way, name) for way, group in WAYS.items() for name in group]
)
def test_the_values_say_what_happens_between_rows(way: str, name: str) -> None:
    """Steps are held, ramps and noise are lines, what is sampled well is smooth."""
    values = WAYS[way][name]
    assert choose_hold(T, values) == way
    assert holds_its_value(values) == (way == "previous")


def test_independent_values_are_sent_out_by_a_program() -> None:
    """A new random value at every row is held too, though it repeats nothing."""
    values = np.random.default_rng(1).normal(size=ROWS)
    assert choose_hold(T, values) == "previous"
    assert not holds_its_value(values)


def test_uneven_rows_of_a_sine_are_smooth() -> None:
    """The cubic through neighbours takes the times as they are."""
    t = np.cumsum(np.random.default_rng(2).uniform(0.3, 1.7, ROWS))
    assert choose_hold(t, np.sin(t / 4)) == "smooth"


def with_input(values: np.ndarray, **further: object) -> Trajectory:
    """Give a run of one state and one input."""
    return Trajectory(T, T[:, None], ("x",), values[:, None], ("u",), **further)  # type: ignore[arg-type]


def test_all_runs_of_a_call_hold_an_input_alike() -> None:
    """A run in which the input does not move follows the others; rows that are selected too."""
    runs, _ = take_trajectories([with_input(np.full(ROWS, 2.0)), with_input(np.sin(T / 8))])
    assert [run.hold for run in runs] == [{"u": "smooth"}] * 2
    assert runs[0].select(slice(20)).hold == {"u": "smooth"}


def test_what_the_user_says_goes_before_the_values() -> None:
    """The ways of a trajectory, then the call's, overrule what the values tell."""
    run = with_input(np.sin(T / 8), hold={"u": "linear"})
    assert run.holds == {"u": "linear"}
    assert decide_hold([run])[0].hold == {"u": "linear"}
    assert decide_hold([run], "previous")[0].hold == {"u": "previous"}


@pytest.mark.parametrize(
    ("hold", "says"),
    [
        ({"v": "linear"}, "hold names 'v', which is no input; the inputs are: u"),
        ({"u": "zoh"}, "input 'u' cannot be held 'zoh'; the ways are: previous, linear, smooth"),
        ("cubic", "input 'u' cannot be held 'cubic'"),
        (3, "hold 3 must be one of previous, linear, smooth"),
    ],
)
def test_an_unknown_input_or_way_is_one_line(hold: object, says: str) -> None:
    """A wrong name or word is answered with the choices."""
    with pytest.raises(InputError, match=says):
        decide_hold([with_input(T)], hold)  # type: ignore[arg-type]
