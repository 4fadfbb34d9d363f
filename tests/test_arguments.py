"""Arguments of a wrong type: every public function and class names the argument in one line."""

import inspect
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import dynsr
from dynsr.arguments import checked, expected, fits
from dynsr.discovery import DiscoverySettings
from dynsr.errors import DynsrError, InputError
from dynsr.parameters import DelaySettings

ODD = [
    None,
    object(),
    3.5,
    "text",
    [1, [2, 3]],
    {1, 2},
    b"by",
    {"a": object()},
    -1,
    [],
    True,
    float("nan"),
    (object(), object()),
    np.zeros((2, 2)),
]
T = np.linspace(0, 3, 16)
RUN = dynsr.Trajectory(T, np.exp(-T)[:, None], ("x",))
# Those that would compute for minutes where an argument is a fine one.
LONG = {"replicate", "audit"}
DOORS = [
    name
    for name in dynsr.__all__
    if callable(getattr(dynsr, name))
    and not (isinstance(getattr(dynsr, name), type) and issubclass(getattr(dynsr, name), Exception))
]


@pytest.fixture(scope="module")
def usual() -> dict[str, Any]:
    """Give what a call is made with where one argument is odd, by the names of the arguments."""
    samples = dynsr.make_samples(RUN, "x")
    found = dynsr.discover(RUN, preset="quick", jobs=1, method="sindy")
    pendulum = dynsr.find_system("pendulum")
    expr = dynsr.parse("-9.81*sin(theta1)")
    return {
        "data": RUN,
        "source": RUN,
        "trajectory": RUN,
        "trajectories": [RUN],
        "samples": samples,
        "found": found,
        "system": pendulum,
        "expr": expr,
        "exprs": [expr] * 2,
        "t": T,
        "x": RUN.x,
        "X": samples.X,
        "y": samples.y,
        "names": ("x",),
        "states": ("x",),
        "rhs": (dynsr.parse("x"),),
        "x0": (1.0,),
        "target": "x",
        "scheme": "forward",
        "text": "x",
        "relative": 0.1,
        "rng": np.random.default_rng(0),
        "equations": {"x": dynsr.parse("x")},
        "errors": {"x": ()},
        "loss": 0.1,
        "complexity": 1.0,
    }


# What makes a call with all else usual a short one.
FEW_DELAYS = replace(
    DiscoverySettings(), delays=DelaySettings(grid=3, minima=1, sums=1, searched=1)
)
SHORT: dict[str, dict[str, Any]] = {
    "discover": {"preset": "quick", "jobs": 1, "method": "sindy", "settings": FEW_DELAYS},
    "bootstrap": {"members": 2},
    "make_method": {"name": "sindy"},
    "printed_loss": {"method": "ga"},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in DOORS if name not in LONG])
def test_every_public_door_names_an_argument_of_a_wrong_type(name, usual, tmp_path, monkeypatch):
    """Whatever one argument is, the call gives a result or one line of dynsr's own."""
    monkeypatch.chdir(tmp_path)
    door = getattr(dynsr, name)
    parameters = inspect.signature(door).parameters.values()
    due = [p for p in parameters if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    # An own scheme of samples that are made by hand is any text.
    base = {p.name: usual.get(p.name, "x") for p in due} | SHORT.get(name, {})
    for parameter in parameters:
        for odd in ODD:
            given = {**base, parameter.name: odd}
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    door(**given)
            except DynsrError as error:
                assert "\n" not in str(error), (parameter.name, odd)  # noqa: PT017
            except Exception as error:
                pytest.fail(f"{name}({parameter.name}={odd!r}): {type(error).__name__}: {error}")


@pytest.mark.parametrize("name", DOORS)
def test_every_public_door_is_checked(name):
    """No function or class of the package is without the check."""
    door = getattr(dynsr, name)
    own = vars(door).get("__init__", door) if isinstance(door, type) else door
    assert name == "AbstractMethod" or own.__globals__["__name__"] == "dynsr.arguments"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: dynsr.simulate("pendulum"),
            "simulate takes system as a System, not 'pendulum' (str)",
        ),
        (
            lambda: dynsr.parse("x", 3),
            "parse takes names as a sequence of texts or None, not 3 (int)",
        ),
        (
            lambda: dynsr.discover(RUN, terms=None, jobs=1),
            "discover takes terms as a sequence of text or an Expr, not None (NoneType)",
        ),
        (
            lambda: dynsr.add_noise(RUN, 0.1, 7),
            "add_noise takes rng as a Generator, not 7 (int)",
        ),
        (
            lambda: dynsr.replicate(systems=7, report=False),
            "replicate takes systems as a sequence of text or a System, not 7 (int)",
        ),
    ],
)
def test_the_line_says_argument_value_and_what_is_due(call, words):
    """Which argument, what is expected in words, what was given and of which type."""
    with pytest.raises(InputError) as said:
        call()
    assert str(said.value) == words


@pytest.mark.parametrize(
    ("value", "kind", "fit"),
    [
        (3, int, True),
        (np.int64(3), int, True),
        (True, int, False),
        (3, float, True),
        (np.float32(3), float, True),
        (dynsr.parse("1.5"), float, True),
        ("3", float, False),
        (np.bool_(True), bool, True),
        (1, bool, False),
        ("ab", Sequence[str], False),
        (["a", "b"], Sequence[str], True),
        (["a", 1], Sequence[str], False),
        ({"a"}, Sequence[str], False),
        ({"a"}, Iterable[str], True),
        (np.array(["a"]), Sequence[str], True),
        ((1, 2.0), tuple[float, float], True),
        ((1, 2.0, 3), tuple[float, float], False),
        ((1, 2.0, 3), tuple[float, ...], True),
        ({"a": 1}, Mapping[str, int], True),
        ({"a": "1"}, Mapping[str, int], False),
        ([1], Mapping[str, int], False),
        (None, str | None, True),
        (b"a", str | None, False),
        (Path("a"), str | Path, True),
        (len, Callable[..., int] | None, True),
        (3, Callable[..., int] | None, False),
        ("a", Literal["a", "b"], True),
        ("c", Literal["a", "b"], False),
        ([[1, 2], [3, 4]], np.ndarray, True),
        ([[1, 2], [3]], np.ndarray, False),
        (["a"], np.ndarray, False),
        (object(), Any, True),
    ],
)
def test_types_are_read_as_annotations_mean_them(value, kind, fit):
    """Numbers of NumPy and SymPy are numbers, text is no sequence of texts, and so on."""
    assert fits(value, kind) is fit
    assert isinstance(expected(kind), str)


def test_a_fault_of_dynsr_stays_one():
    """Where all arguments are of their types, an error is not blamed on them; nor on a callback."""

    @checked
    def broken(number: float, call: Callable[[], None] | None = None) -> float:
        if call is not None:
            call()
        return number.missing

    with pytest.raises(AttributeError):
        broken(3.0)
    with pytest.raises(KeyError):
        broken(3.0, {}.popitem)
    with pytest.raises(TypeError, match="unexpected keyword"):
        broken(3.0, other=1)
    with pytest.raises(InputError, match="broken takes number as a number, not 'three'"):
        broken("three")


def test_a_check_leaves_signature_and_words_as_they_are():
    """Help, tab completion and scikit-learn see what they saw before."""
    names = list(inspect.signature(dynsr.parse).parameters)
    assert names == ["text", "names", "values", "functions"]
    assert (dynsr.parse.__doc__ or "").startswith("Read an expression")
    regressor = dynsr.DynsrRegressor(preset="quick")
    assert regressor.get_params()["preset"] == "quick"
