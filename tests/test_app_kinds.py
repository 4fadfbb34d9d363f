"""The local page: runs that differ, hidden states, delays, chance, limits, errors and sums."""

import inspect
import math
from dataclasses import replace

import numpy as np
import pytest

import dynsr
from dynsr.app import work as works
from dynsr.app.desk import OF_COLUMNS
from dynsr.app.fields import in_fields
from dynsr.app.work import FILES, Work, read_options
from dynsr.data import Trajectory
from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.fit import ParetoFront
from dynsr.parameters import Delay

QUICK = {"preset": "quick", "functions": []}


def write_table(folder, columns, name="a"):
    """Write columns, of numbers and of words, as a table; gives the file."""
    rows = zip(*(map(str, own) for own in columns.values()), strict=True)
    path = folder / f"{name}.csv"
    path.write_text("\n".join([",".join(columns), *map(",".join, rows)]))
    return str(path)


class Desk(Work):
    """Work on columns, with the parts of the page."""

    def __init__(self, folder):
        self.parts: dict = {}
        self.folder = folder
        super().__init__(folder, self.parts.__setitem__, 1)

    def look(self, columns):
        """Read columns; gives what the page shows of them."""
        self.path = write_table(self.folder, columns)
        self.read(self.path)
        return self.parts["table"]

    def change(self, **changed):
        """Read the same columns again with something said of them, as the page sends it."""
        said = {
            kind: {c["name"]: c[kind.removesuffix("s")] for c in self.parts["table"]["columns"]}
            for kind in OF_COLUMNS
        }
        self.read(self.path, **{kind: own | changed.get(kind, {}) for kind, own in said.items()})
        return self.parts["table"]

    def column(self, name):
        """Give what the page shows of a column."""
        return next(c for c in self.parts["table"]["columns"] if c["name"] == name)


@pytest.fixture
def desk(tmp_path):
    """Give what reads a table and works on it."""
    return Desk(tmp_path)


@pytest.fixture
def asked(monkeypatch):
    """Put a discovery in the place of every search, and give what was asked for."""
    given: dict = {}

    def search(runs, **settings):
        given.update(settings, runs=runs)
        if "found" not in given:
            raise InputError("nothing is searched here")
        return given["found"]

    monkeypatch.setattr(works, "discover", search)
    return given


def runs_of(desk, asked, **options):
    """Give the trajectories that a search gets."""
    with pytest.raises(InputError, match="nothing is searched here"):
        desk.search({**QUICK, **options})
    return asked["runs"]


def drawn_curves(monkeypatch):
    """Give the list of what is drawn as curves."""
    curves = []
    draw = works.draw_states

    def note(run, model=None, bands=None):
        curves.append((run, model, bands))
        return draw(run, model, bands)

    monkeypatch.setattr(works, "draw_states", note)
    return curves


def check_files(desk):
    """Every file can be downloaded, and a process that takes the place of another has all of it."""
    found = desk.parts["found"]
    for name in (*FILES, *(one["file"] for one in found["exports"])):
        desk.write(name)
        assert (desk.folder / name).stat().st_size > 50
    again = Desk(desk.folder)
    again.read(desk.path)
    again.restore()
    assert again.parts["found"] == found
    again.redraw({}, 0)
    assert again.parts["picture"]["said"] == ""


def decays(rates=(0.4, 0.7, 1.1), rows=40):
    """Give runs of one decay, each with a rate of its own."""
    t = np.linspace(0, 4, rows)
    return {
        "run": np.repeat([1, 2, 3], rows),
        "t": np.tile(t, 3),
        "x": np.concatenate([3 * np.exp(-k * t) for k in rates]),
    }


def test_options_for_other_kinds_of_data_are_arguments_of_discover():
    """What the page sends of runs, hidden states, delays and chance is what discover takes."""
    sent = {"vary": "*", "hidden": "y", "delays": "1.5, 3", "stochastic": True}
    found = read_options(sent, ["x"])
    assert found == {"vary": True, "hidden": "y", "delays": [1.5, 3.0], "stochastic": True}
    assert found.keys() <= inspect.signature(dynsr.discover).parameters.keys()
    assert read_options({"vary": "x", "delays": "*"}, ["x"]) == {"vary": ["x"], "delays": True}
    with pytest.raises(InputError, match="delay 'long' is not a number"):
        read_options({"delays": "long"}, ["x"])


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"vary": "*", "delays": "*"}, "delays go with constants that all trajectories share"),
        ({"hidden": "y", "vary": "*"}, "vary does not go with a hidden state"),
        ({"hidden": "y", "stochastic": True}, "stochastic does not go with a hidden state"),
        ({"stochastic": True, "delays": "*"}, "delays does not go with stochastic"),
        ({"hidden": "x"}, "'x' is a column of the data; give the hidden state another name"),
        ({"delays": "9"}, "a delay of 9 is not between 0 and"),
    ],
)
def test_what_does_not_go_together_is_refused_as_by_discover(desk, options, line):
    """The page gives the one line of discover for options that exclude each other."""
    desk.look(decays())
    with pytest.raises(InputError, match=line) as refused:
        desk.search({**QUICK, **options})
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_constants_of_each_run_are_a_table(desk, monkeypatch):
    """Constants that differ are shown by run with intervals; the picture has the run's own."""
    curves = drawn_curves(monkeypatch)
    assert desk.look(decays())["runs"] == 3
    desk.search({**QUICK, "vary": "*"})
    found = desk.parts["found"]
    assert [e["text"] for e in found["equations"]] == ["x' = -k1*x"]
    assert found["by_run"]["head"] == ("Run", "k1", "95 % interval")
    values = [(run, float(value)) for run, value, _ in found["by_run"]["rows"]]
    assert values == [("1", 0.4), ("2", 0.7), ("3", 1.1)]
    assert all(" to " in interval for *_, interval in found["by_run"]["rows"])
    assert found["by_run"]["note"].startswith("k1 differs from run to run.")
    # What is left is a sign, which no slider moves.
    assert [one["fixed"] for one in found["constants"]] == [True]
    assert found["moving"][0].startswith("No slider moves k1")
    for run, rate in enumerate((0.4, 0.7, 1.1)):
        desk.redraw({}, run)
        model = curves[-1][1]
        assert model.x[:, 0] == pytest.approx(3 * np.exp(-rate * model.t), rel=1e-4)
    check_files(desk)


def test_a_constant_that_follows_a_known_number_is_said(desk, asked):
    """Where a formula takes the place of constants by run there is no table, and it is said."""
    table = desk.look({**decays(), "kelvin": np.repeat([280.0, 300.0, 320.0], 40)})
    assert "kelvin" in table["guess"]
    by_run = dynsr.discovery.RunParameters(("1", "2", "3"), follows={"k1": "exp(-9/kelvin)"})
    x = parse("-exp(-9/kelvin)*x")
    runs = tuple(runs_of(desk, asked))
    asked["found"] = dynsr.Discovery({"x": x}, {"x": ()}, {}, {}, runs, by_run=by_run)
    desk.search({**QUICK, "vary": "x"})
    assert asked["vary"] == ["x"]
    assert desk.parts["found"]["by_run"] is None
    assert desk.parts["found"]["facts"] == ["k1 differs too: it is exp(-9/kelvin)."]


@pytest.mark.slow
def test_noise_in_the_motion_is_shown_as_drift_and_diffusion(desk, monkeypatch):
    """Chance in the motion gives a path, a band around it, and the variance with its interval."""
    rng, x = np.random.default_rng(0), [1.0]
    while len(x) < 600:
        x.append(x[-1] * math.exp(-0.1) + rng.normal(0, math.sqrt(0.1 * (1 - math.exp(-0.2)))))
    curves = drawn_curves(monkeypatch)
    desk.look({"t": 0.1 * np.arange(600), "x": x})
    desk.search({**QUICK, "stochastic": True})
    found = desk.parts["found"]
    [constant] = found["constants"]
    assert found["equations"][0]["text"].endswith("*x") and constant["value"] < 0
    assert found["noise"][0].startswith("Noise in the motion of x: variance 0.")
    assert found["steps"].startswith("<svg") and "diffusion of x" in found["steps"]
    assert found["moving"][0].startswith("The picture has one path with noise in the motion")
    _, model, bands = curves[-1]
    low, high = bands["x"]
    assert np.mean((low <= model.x[:, 0]) & (model.x[:, 0] <= high)) > 0.8
    before = desk.parts["picture"]["svg"]
    desk.redraw({"x": [2 * constant["value"]]}, 0)
    assert desk.parts["picture"]["said"] == "" and desk.parts["picture"]["svg"] != before
    narrow = np.median(curves[-1][2]["x"][1] - curves[-1][2]["x"][0])
    assert narrow < 0.9 * np.median(high - low)
    check_files(desk)


@pytest.mark.slow
def test_a_delay_is_followed_from_the_history_of_its_run(desk, asked, monkeypatch):
    """Equations with a delay are solved with what each run was before, and the delay is shown."""
    # x' = -x(t - 1)*pi/2 has the solutions a*cos(pi*t/2 + b).
    t = np.linspace(0, 8, 161)
    waves = [lambda t: np.cos(np.pi * t / 2), lambda t: 3 * np.cos(np.pi * t / 2 + 1)]
    curves = drawn_curves(monkeypatch)
    both = np.concatenate([wave(t) for wave in waves])
    desk.look({"run": np.repeat([1, 2], len(t)), "t": np.tile(t, 2), "x": both})
    runs = tuple(
        Trajectory(t, wave(t)[:, None], ("x",), wave(t - 1)[:, None], ("x_delayed",))
        for wave in waves
    )
    asked["found"] = dynsr.Discovery(
        {"x": -math.pi / 2 * parse("x_delayed")},
        {"x": ((-math.pi / 2, 0.01),)},
        {"x": ParetoFront()},
        {},
        runs,
        delays={"x_delayed": Delay("x", 1.0, 0.01, 0.98, 1.02)},
    )
    desk.search({**QUICK, "delays": "1"})
    assert asked["delays"] == [1.0]
    assert desk.parts["found"]["facts"] == ["x(t - 1), the delay is 0.98 to 1.02."]
    assert desk.parts["found"]["moving"] == ["What was before the first row is read from the data."]
    for run, wave in enumerate(waves):
        desk.redraw({}, run)
        model = curves[-1][1]
        assert model.x[:, 0] == pytest.approx(wave(model.t), abs=1e-3)
    desk.redraw({"x": [-1.0]}, 1)
    assert desk.parts["picture"]["said"] == ""
    assert not np.allclose(curves[-1][1].x[:, 0], waves[1](t), atol=0.1)
    check_files(desk)


@pytest.mark.slow
def test_a_hidden_state_is_a_curve_of_which_something_is_unknown(desk, asked):
    """A state that nobody measured has its curve, its slider-free factor, and a word of doubt."""
    t = np.linspace(0, 6, 61)
    desk.look({"t": t, "x": np.cos(2 * t)})
    gaps = np.tile([False, True], (61, 1))
    states = np.column_stack([np.cos(2 * t), -2 * np.sin(2 * t)])
    run = Trajectory(t, states, ("x", "y"), unmeasured=gaps)
    found = dynsr.Discovery(
        {"x": parse("y"), "y": parse("-4*x")},
        {"x": (), "y": ((-4.0, 0.01),)},
        {"x": ParetoFront(), "y": ParetoFront()},
        {},
        (run,),
        settings={"hidden": {"y": "y"}},
    )
    why = {"y": f"y' = -4*x: law; was not measured. {found.hidden_notes['y']}"}
    asked["found"] = replace(found, explanation=why)
    desk.search({**QUICK, "hidden": "y"})
    assert asked["hidden"] == "y"
    assert "y, not measured" in desk.parts["picture"]["svg"] and desk.parts["picture"]["said"] == ""
    assert "Its scale and sign are chosen" in desk.parts["found"]["equations"][1]["why"]
    assert desk.parts["found"]["moving"][0].startswith("Nobody measured y")
    before = desk.parts["picture"]["svg"]
    desk.redraw({"y": [-5.0]}, 0)
    assert desk.parts["picture"]["svg"] != before and desk.parts["picture"]["said"] == ""
    check_files(desk)


def test_formulas_of_a_search_that_was_ended_must_be_of_columns(desk):
    """Formulas with a delay that only a whole search determines are refused in one line."""
    desk.look(decays())
    with pytest.raises(InputError, match="the best so far contains 'x_delayed', which only"):
        desk.keep({"x": "-x_delayed"}, {**QUICK, "delays": "*"})


def test_notes_name_the_fields_of_the_page(desk):
    """Where the shell has options, the page has roles, fields of columns and ticks."""
    shown = desk.look({**limited(), "F": np.repeat([0.0, 2.0], [15, 16])})
    notes = " ".join(shown["notes"])
    assert "say the limit, and they count: the field 'limit' of drug" in notes
    assert "the role 'state' says otherwise" in notes and "--" not in notes
    wrong = desk.change(roles={"t": "unused", "S": "time"})["error"]
    assert "--" not in wrong


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        (
            "name it, e.g. --time seconds, or add",
            "name it, e.g. the role 'time' for seconds, or add",
        ),
        (
            "--quantity none says otherwise.",
            "another role than 'names the quantity' says otherwise.",
        ),
        (
            "say: --dose S=D/V.",
            "say: the role 'doses of a state' for D, divided by a volume, added to S.",
        ),
        ("its rows (--hold).", "its rows (the field 'between rows')."),
        ("try --order x=2.", "try 'equations for accelerations'."),
        ("--decimal says the mark", "the option --decimal of the shell says the mark"),
        ("a -- b, x--states, 3--4", "a -- b, x--states, 3--4"),
    ],
)
def test_every_option_has_its_field(said, shown):
    """What the page has no field for is said to be an option of the shell."""
    assert in_fields({"notes": [said], "python": said}) == {"notes": [shown], "python": said}


def limited():
    """Give columns of which one has errors of its own, one cells below a limit, and one a sum."""
    t = np.linspace(0, 6, 31)
    drug = [f"{x:.4f}" if x > 0.1 else "BDL" for x in np.exp(-0.7 * t)]
    light = [f"{x:.4f}" if x > 0.1 else "<0.1" for x in np.exp(-0.9 * t)]
    return {
        "t": t,
        "S": 1 + np.cos(t),
        "S_sd": 0.1 + 0.01 * t,
        "drug": drug,
        "light": light,
        "total": 3 + np.cos(t) + np.sin(t),
    }


@pytest.mark.slow
def test_errors_in_a_column_keep_their_role(desk, asked):
    """A column called so is the ratios of errors until the reader says that they are absolute."""
    desk.look(limited())
    own = desk.column("S_sd")
    assert (own["role"], own["way"], own["called"]) == ("error", "S*", "S")

    def noise(**changed):
        assert desk.change(**changed)["error"] == ""
        return runs_of(desk, asked)[0].noise.get("S")

    # Another column may change its role, and the errors stay.
    known = noise(roles={"total": "unused"})
    assert not known.sure and known.sd[0] == pytest.approx(0.1)
    assert desk.column("S_sd")["way"] == "S*"
    known = noise(ways={"S_sd": "S"})
    assert known.sure and known.sd[-1] == pytest.approx(0.16)
    assert desk.column("S_sd")["way"] == "S"
    assert noise(roles={"S_sd": "unused"}) is None
    known = noise(errors={"S": "5 %"})
    assert known.share == 0.05 and known.sure
    assert desk.column("S")["error"] == "5 %"
    assert set(noise(errors={"S": "0.2"}).sd) == {0.2}
    assert desk.change(errors={"S": "much"})["error"].startswith("no column 'much' for the noise")
    both = desk.change(roles={"S_sd": "error", "total": "error"}, errors={"S": ""})
    assert both["error"] == "columns 'S_sd' and 'total' are both errors of 'S'; choose one"


def test_only_a_column_that_is_a_state_has_fields_for_errors(desk):
    """States that are quantities, or runs side by side, have no column for errors or a limit."""
    falls, rises = [0.9**k for k in range(20)], [1.1**k for k in range(20)]
    long = {"variable": ["S"] * 20 + ["P"] * 20, "t": [*range(20), *range(20)]}
    table = desk.look({**long, "value": falls + rises})
    assert (table["states"], desk.column("value")["own"]) == (["S", "P"], False)
    desk.path = write_table(desk.folder, {"t": range(20), "x_rep1": falls, "x_rep2": rises}, "b")
    desk.read(desk.path)
    assert [desk.column(f"x_rep{k}")["own"] for k in (1, 2)] == [False, False]
    # Where nothing is a state, that is what is said.
    nothing = dict.fromkeys(("x_rep1", "x_rep2"), "error")
    assert "no column left for a state" in desk.change(roles=nothing)["error"]


@pytest.mark.slow
def test_cells_below_a_limit_count_as_such(desk, asked):
    """Cells such as <0.1 count as they are; those such as BDL as soon as the limit is typed."""
    desk.look(limited())
    assert [desk.column(n)["open"] for n in ("drug", "light", "S")] == [True, False, False]
    assert list(runs_of(desk, asked)[0].limits) == ["light"]
    assert "below a limit" in desk.parts["preview"]["svg"]
    table = desk.change(limits={"drug": "0.1"})
    assert table["error"] == "" and desk.column("drug")["limit"] == "0.1"
    assert any("'drug' is beyond a limit in" in note for note in table["notes"])
    assert {"drug", "light"} == set(runs_of(desk, asked)[0].limits)
    line = "no column 'low' for the limit in a.csv"
    assert desk.change(limits={"drug": "low"})["error"].startswith(line)


def test_cells_beyond_a_limit_are_shown_as_such(desk):
    """The first rows show a limit where the table has one, and words where it does not say it."""
    more = range(1, 29)
    desk.look({"t": range(30), "x": ["BDL", "2.5", *more], "y": ["<0.5", ">99", *more]})
    assert desk.column("x")["cells"][:3] == ["below a limit", "2.5", "1"]
    assert desk.column("y")["cells"][:3] == ["<0.5", ">99", "1"]


@pytest.mark.slow
def test_a_column_may_be_a_sum_of_states(desk, asked):
    """A sum that is typed gives the state that has no column; a blank or wrong one is refused."""
    desk.look(limited())
    table = desk.change(roles={"total": "sum"})
    assert table["error"] == "column 'total' is a sum; type of which states, such as S + I"
    table = desk.change(roles={"total": "sum"}, ways={"total": "S + I"})
    assert (table["error"], table["states"]) == ("", ["S", "drug", "light", "I"])
    assert (desk.column("total")["role"], desk.column("total")["way"]) == ("sum", "S + I")
    runs = runs_of(desk, asked, nonnegative=True)
    assert asked["observed"] == {"total": "S + I"} and asked["nonnegative"] == (
        "S",
        "drug",
        "light",
        "I",
    )
    assert runs[0].states == ("S", "drug", "light", "total")
    asked["found"] = works.keep_formulas({"S": parse("-I"), "I": parse("S")}, desk._parts())
    desk.search(QUICK)
    assert desk.parts["picture"]["said"] == "" and ">I<" in desk.parts["picture"]["svg"]
    assert "no sum of states" in desk.change(ways={"total": "S*I"})["error"]
