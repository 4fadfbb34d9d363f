"""Settings of runs: a layout of a plate or a list of experiments gives the parameters of runs."""

import numpy as np
import pandas as pd
import pytest

import dynsr
from dynsr.data import describe, read_trajectories
from dynsr.errors import InputError

T = np.arange(0.0, 12.0, 0.5)
DOSES = {"A1": 0.5, "A2": 1.0, "A3": 2.0, "B1": 0.5, "B2": 1.0, "B3": 2.0}
GROWTH = {well: 0.1 * np.exp(0.3 / (1 + dose) * T) for well, dose in DOSES.items()}
BLANK = 0.04 + 0.001 * np.cos(9 * T)
PLATE = pd.DataFrame({"Time (h)": T, **GROWTH, "C1": BLANK})
LAYOUT = pd.DataFrame(
    {
        "Well": ["C1", "B3", "B2", "B1", "A3", "A2", "A1"],
        "Strain": ["blank", "m", "m", "m", "wt", "wt", "wt"],
        "Dose (mM)": [np.nan, 2, 1, 0.5, 2, 1, 0.5],
        "pH": 7.0,
    }
)


def doses(runs):
    """Give the dose of each run, which is constant along it."""
    assert all(np.ptp(run.by_name["Dose"]) == 0 for run in runs)
    return [float(run.by_name["Dose"][0]) for run in runs]


@pytest.mark.parametrize("first", [True, False])
def test_a_layout_gives_each_well_its_parameters(tmp_path, first):
    """As a file in any order of the two, whose blank wells are left out, with a note."""
    PLATE.to_csv(tmp_path / "plate.csv", index=False)
    layout = LAYOUT.assign(Well=LAYOUT["Well"].str[0] + "0" + LAYOUT["Well"].str[1])
    layout.to_csv(tmp_path / "layout.csv", index=False)
    files = [tmp_path / "plate.csv", tmp_path / "layout.csv"]
    table = read_trajectories(files if first else files[::-1])
    assert table.names == tuple(DOSES) and doses(table.trajectories) == list(DOSES.values())
    found = table.description
    assert found.parameters == ("Dose",) and found.units["Dose"] == "mM"
    assert "text of layout.csv" in found.left_out["Strain"]
    assert found.left_out["pH"] == "is the same in every run"
    assert any("Trajectory C1 was left out: layout.csv has an" in note for note in found.notes)


def test_a_sheet_of_settings_and_a_frame_do_as_well(tmp_path):
    """What is asked of the runs goes on; a setting may be named among the inputs."""
    with pd.ExcelWriter(tmp_path / "plate.xlsx") as book:
        PLATE.to_excel(book, sheet_name="Data", index=False)
        LAYOUT.to_excel(book, sheet_name="Layout", index=False)
    book = str(tmp_path / "plate.xlsx")
    table = read_trajectories([f"{book}:Data", f"{book}:Layout"], inputs=["Dose"])
    assert doses(table.trajectories) == list(DOSES.values())
    long = PLATE.melt("Time (h)", var_name="well", value_name="OD")
    runs = read_trajectories([long, LAYOUT], noise={"OD": 0.01}).trajectories
    assert doses(runs) == list(DOSES.values()) and runs[0].states == ("OD",)


@pytest.mark.parametrize("form", ["plate.csv", "plate.xlsx"])
def test_rows_above_the_wells_say_what_was_set_in_them(tmp_path, form):
    """A plate reader writes the layout there; a sentence above it is skipped as before."""
    own = LAYOUT.set_index("Well").loc[list(PLATE.columns[1:])]
    above = [["Plate 7", *[""] * 7], ["Strain", *own["Strain"]], ["Dose (mM)", *own["Dose (mM)"]]]
    rows = [*above, list(PLATE.columns), *PLATE.to_numpy().tolist()]
    sheet = pd.DataFrame(rows)
    path = tmp_path / form
    if form.endswith("csv"):
        sheet.to_csv(path, index=False, header=False)
    else:
        sheet.to_excel(path, index=False, header=False)
    table = read_trajectories(path)
    assert table.names == tuple(DOSES) and doses(table.trajectories) == list(DOSES.values())
    assert table.description.units["Dose"] == "mM" and "Strain" in table.left_out
    assert not any("2" in note and "skipped" in note for note in table.notes)


def test_a_list_of_files_names_them(tmp_path):
    """With or without the ending; one that is missing is named."""
    for k, well in enumerate(DOSES):
        own = pd.DataFrame({"t": T, "OD": (k + 1) * GROWTH[well]})
        own.to_csv(tmp_path / f"run{k}.csv", index=False)
    files = sorted(tmp_path.glob("*.csv"))
    made = pd.DataFrame({"file": [f.stem for f in files], "Dose": list(DOSES.values())})
    assert doses(read_trajectories([*files, made]).trajectories) == list(DOSES.values())
    with pytest.raises(
        InputError, match=r"the data frame has no row of run5.csv in its column 'file'"
    ):
        read_trajectories([*files, made[:-1]])
    with pytest.raises(InputError, match=r"column 'OD' of the data frame is one of the runs too"):
        read_trajectories([*files, made.rename(columns={"Dose": "OD"})])


def test_what_names_other_runs_is_read_as_before():
    """A table without a time whose names are those of no run is refused."""
    with pytest.raises(InputError, match="looks like the time"):
        describe([PLATE, LAYOUT.assign(Well=list("stuvwxy"))])


@pytest.mark.slow
def test_a_law_has_the_dose_of_a_layout():
    """Growth that falls with the dose is found over all wells."""
    found = dynsr.discover([PLATE, LAYOUT], jobs=1)
    assert found.verdict.level == "law"
    assert {str(s) for s in found.equations["x"].free_symbols} == {"x", "Dose"}
