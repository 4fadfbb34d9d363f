"""Seconds to the right law: dynsr beside pysindy, pyoperon, gplearn, PySR and the first AI Feynman.

All are given the same rows of the same textbook systems, clean and with 5 % noise, first with one
thread each, then with all cores. The script makes an environment of its own for them in
.cache/peers (and one for aifeynman, which needs old packages and gfortran) and runs itself there.
Every case is kept in the folder of --out; the next call goes on where this one was stopped.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
HOME = ROOT / ".cache" / "peers"
OLD = ROOT / ".cache" / "aifeynman"
PACKAGES = ("pyoperon==0.6.2", "gplearn==0.4.3")
BEGIN, END = "<!-- peers -->\n", "<!-- end of peers -->\n"
# What is done to the data before slopes are regressed on: windows of Savitzky and Golay.
WINDOWS = (0, 9, 33)
CAP = 300.0


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=12, help="systems of it, drawn by --seed")
    parser.add_argument("--noise", default="0,0.05", help="levels, by commas")
    parser.add_argument("--methods", default="dynsr,stlsq,operon,gplearn,pysr", help="by commas")
    parser.add_argument("--threads", default=f"1,{os.cpu_count()}", help="threads each, by commas")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-aifeynman", action="store_true")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "peers")
    parser.add_argument("--page", type=Path, help="page of the docs to write the tables into")
    return parser.parse_args()


def make_home() -> Path:
    """Make the environment of dynsr and its peers, if it is not there yet; give its Python."""
    python = HOME / "bin" / "python"
    mark = HOME / "made"
    if not mark.exists():
        print("making an environment for the peers (once; a few minutes) ...", file=sys.stderr)
        subprocess.run([sys.executable, "-m", "venv", HOME], check=True)
        install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        locked = ["--constraint", ROOT / "scripts" / "constraints.txt"]
        own = ["--editable", f"{ROOT}[pysindy]"]
        subprocess.run([*install, *locked, *own, *PACKAGES], check=True)
        mark.touch()
    return python


def make_old_home() -> str:
    """Make the environment of aifeynman; give what is in the way, "" where it is ready."""
    python, mark = OLD / "bin" / "python", OLD / "made"
    if mark.exists():
        return ""
    if shutil.which("gfortran") is None:
        return "it is built with gfortran, which is not here (Debian: apt-get install gfortran)"
    install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    steps = (
        [sys.executable, "-m", "venv", OLD],
        [*install, "numpy<1.26", "setuptools<60", "wheel"],
        [*install, "--no-deps", "--no-build-isolation", "aifeynman==2.0.7"],
        [*install, "numpy<1.26", "torch==2.13.0", "sympy", "matplotlib", "seaborn"],
        [*install, "numpy<1.26", "scikit-learn", "sortedcontainers"],
    )
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode:
            return "its environment cannot be made: " + done.stderr.strip().splitlines()[-1][:200]
    mark.touch()
    return ""


def slopes(data: Any) -> Iterator[tuple[Any, Any]]:
    """Give states and slopes, (n, k) each: differences as measured, and of smooths."""
    import numpy as np
    import pysindy
    from scipy.signal import savgol_filter

    even = np.linspace(data.t[0], data.t[-1], len(data))
    smooth = np.column_stack([np.interp(even, data.t, column) for column in data.x.T])
    for window in WINDOWS:
        if not window:
            yield data.x, np.asarray(pysindy.FiniteDifference(order=4)(data.x, data.t))
        elif window <= len(data) // 2:
            x = savgol_filter(smooth, window, 3, axis=0)
            yield x, np.asarray(pysindy.FiniteDifference(order=2)(x, even))


def regress(data: Any, seed: int, fit: Callable[[Any, Any, Sequence[str], int], str]) -> Any:
    """Regress each state's slope on the states; of the smooths take the one that follows best.

    Parameters
    ----------
    data : the trajectory.
    seed : of the search.
    fit : gives a formula as text from (n, k) states, (n,) slopes, names and seed.
    """
    import numpy as np

    from dynsr.benchmarks.zoo.scoring import Answer
    from dynsr.errors import DynsrError
    from dynsr.expression import parse
    from dynsr.fit import r_squared
    from dynsr.verdict.prediction import predict

    best, score = Answer({}, failure="no formula could be read"), -np.inf
    for x, slope in slopes(data):
        try:
            texts = [fit(x, column, data.states, seed) for column in slope.T]
            found = {
                s: parse(text, data.states) for s, text in zip(data.states, texts, strict=True)
            }
        except (DynsrError, ValueError):
            continue
        try:
            followed = r_squared(data.x, predict(found, data.x[0], data.t, {}).x)
        except (DynsrError, ArithmeticError):
            followed = -1.0
        if followed > score:
            best, score = Answer(found), followed
    return best


def fit_operon(threads: int, x: Any, y: Any, names: Sequence[str], seed: int) -> str:
    """Fit with pyoperon, whose description length picks from its front."""
    from pyoperon.sklearn import SymbolicRegressor

    model = SymbolicRegressor(
        allowed_symbols="add,sub,mul,div,sin,cos,exp,log,sqrt,constant,variable",
        n_threads=threads,
        max_evaluations=100_000,
        max_length=20,
        optimizer_iterations=5,
        objectives=["rmse", "length"],
        model_selection_criterion="minimum_description_length",
        random_state=seed,
    ).fit(x, y)
    return str(model.get_model_string(model.model_, 12, list(names)))


def write_infix(program: list[Any], names: Sequence[str]) -> str:
    """Write gplearn's program, a list in prefix order, as an ordinary formula; empties it."""
    head = program.pop(0)
    if isinstance(head, float):
        return f"({head!r})"
    if isinstance(head, int):
        return names[head]
    parts = [write_infix(program, names) for _ in range(head.arity)]
    signs = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
    if head.name in signs:
        return f"({parts[0]}{signs[head.name]}{parts[1]})"
    return f"{head.name}({parts[0]})"


def _plain(part: Any) -> Any:
    """Give NumPy's numbers as Python's; functions stay as they are."""
    return part.item() if hasattr(part, "item") else part


def fit_gplearn(threads: int, x: Any, y: Any, names: Sequence[str], seed: int) -> str:
    """Fit with gplearn."""
    from gplearn.genetic import SymbolicRegressor

    model = SymbolicRegressor(
        population_size=1000,
        generations=10,
        function_set=("add", "sub", "mul", "div", "sin", "cos"),
        parsimony_coefficient=0.001,
        random_state=seed,
        n_jobs=threads,
    ).fit(x, y)
    return write_infix([_plain(part) for part in model._program.program], names)


def fit_pysr(threads: int, x: Any, y: Any, names: Sequence[str], seed: int) -> str:
    """Fit with PySR; it has 100 iterations and picks by its own score."""
    from pysr import PySRRegressor

    model = PySRRegressor(
        niterations=100,
        binary_operators=["+", "-", "*", "/"],
        unary_operators=["sin", "cos", "exp", "log", "sqrt"],
        parallelism="serial" if threads == 1 else "multithreading",
        deterministic=threads == 1,
        random_state=seed,
        progress=False,
        verbosity=0,
    ).fit(x, y, variable_names=list(names))
    return str(model.sympy())


def answer_dynsr(threads: int, data: Any, seed: int) -> Any:
    """Discover as a user would."""
    from dynsr.benchmarks.zoo.scoring import Answer
    from dynsr.discovery import discover

    found = discover(data, seed=seed, jobs=threads)
    return Answer(found.equations, found.verdict.level)


def answer_peer(fit: Callable[..., str], threads: int, data: Any, seed: int) -> Any:
    """Search by a peer's regressor."""
    return regress(data, seed, partial(fit, threads))


def answer_stlsq(threads: int, data: Any, seed: int) -> Any:
    """Search by pysindy, tuned; it has no use for threads."""
    from dynsr.benchmarks.zoo import peers

    return peers.answer_stlsq(data, seed)


PEERS: Mapping[str, tuple[str, Callable[[int, Any, int], Any]]] = {
    "dynsr": ("dynsr", answer_dynsr),
    "stlsq": ("pysindy", answer_stlsq),
    "operon": ("pyoperon", partial(answer_peer, fit_operon)),
    "gplearn": ("gplearn", partial(answer_peer, fit_gplearn)),
    "pysr": ("pysr", partial(answer_peer, fit_pysr)),
}


def run(options: argparse.Namespace) -> tuple[list[Any], list[str]]:
    """Run every peer that is there on every case; give the records and a line for each absence."""
    import numpy as np

    from dynsr.benchmarks import draw_conditions, find_animals, run_zoo
    from dynsr.cli.progress import SearchProgress

    notes, methods = [], {}
    for name in options.methods.split(","):
        package, answer = PEERS[name]
        if importlib.util.find_spec(package) is None:
            notes.append(f"{package} is not installed in the peers' environment and was skipped.")
            continue
        for count in map(int, options.threads.split(",")):
            methods[f"{name}, {count} thread{'s' * (count > 1)}"] = partial(answer, count)
    animals = find_animals()
    drawn = np.random.default_rng(options.seed).choice(
        len(animals), min(options.systems, len(animals)), replace=False
    )
    levels = [float(level) for level in options.noise.split(",")]
    with SearchProgress() as progress:
        records = run_zoo(
            [animals[i] for i in sorted(drawn)],
            methods,
            partial(draw_conditions, levels=levels, seed=options.seed),
            seed=options.seed,
            out=options.out,
            jobs=1,
            progress=progress,
        )
    return records, notes


def table_of(records: Sequence[Any]) -> Any:
    """Make the table of all: laws, trajectories, seconds, and these against pyoperon's."""
    from dynsr.report import Table

    groups: dict[tuple[float, str], list[Any]] = {}
    for record in records:
        groups.setdefault((record.noise, record.method), []).append(record)
    usual = {
        noise: median(r.seconds for r in group)
        for (noise, method), group in groups.items()
        if method == "operon, 1 thread"
    }
    rows = []
    for (noise, method), group in sorted(groups.items(), key=lambda item: item[0][0]):
        middle = median(r.seconds for r in group)
        right = [r.seconds for r in group if r.is_law]
        unseen = [r.unseen for r in group if r.unseen <= 1]
        rows.append(
            (
                100 * noise,
                method,
                len(group),
                len(right),
                sum(r.reproduced > 0.9 for r in group),
                sum(value > 0.9 for value in unseen),
                middle,
                max(r.seconds for r in group),
                median(right) if right else None,
                middle / usual[noise] if noise in usual else None,
            )
        )
    columns = (
        *("noise (%)", "peer", "cases", "right law", "R2 > 0.9", "unseen > 0.9"),
        *("seconds (median)", "worst", "to a right law", "times pyoperon's"),
    )
    return Table("peers", "Seconds to the right law", columns, tuple(rows))


AIFEYNMAN = """
import os, sys
from aifeynman import run_aifeynman
run_aifeynman(sys.argv[1], "data.txt", 20, "14ops.txt", polyfit_deg=3, NN_epochs=200)
"""


def show_aifeynman(out: Path) -> str:
    """Run the first AI Feynman on two systems; give a table, or why there is none.

    Every equation is kept in the folder ``out`` as it ends.
    """
    from feynman import problems

    from dynsr.report import Table

    reason = make_old_home()
    if reason:
        return f"aifeynman 2.0.7 was not measured: {reason}.\n"
    kept = out / "aifeynman.json"
    rows = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []
    for system, target, samples, truth in problems():
        if [system.name, target] not in [row[:2] for row in rows]:
            rows.append([system.name, target, *run_aifeynman(samples, truth)])
            kept.write_text(json.dumps(rows), encoding="utf-8")
    columns = ("system", "target", "right", "seconds", "ended", "its best formula")
    return Table("aifeynman", "aifeynman 2.0.7", columns, tuple(map(tuple, rows))).to_markdown()


def run_aifeynman(samples: Any, truth: Any) -> tuple[str, float, str, str]:
    """Run it on one target; say whether it is right, after how long, how it ended, and with what.

    Parameters
    ----------
    samples : of the target.
    truth : the true formula.
    """
    import numpy as np
    from feynman import is_right

    from dynsr.expression import to_text

    # Its brute force is programs of its own, which it looks for on the path.
    near = {**os.environ, "PATH": f"{OLD / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    with tempfile.TemporaryDirectory() as folder:
        np.savetxt(Path(folder) / "data.txt", np.column_stack([samples.X, samples.y]))
        began, ended = time.perf_counter(), "by itself"
        command = [OLD / "bin" / "python", "-W", "ignore", "-c", AIFEYNMAN, f"{folder}/"]
        try:
            subprocess.run(
                command, cwd=folder, capture_output=True, check=False, timeout=CAP, env=near
            )
        except subprocess.TimeoutExpired:
            ended = f"after {CAP:g} s"
        seconds = time.perf_counter() - began
        texts = read_solutions(Path(folder), samples.names)
    right = any(is_right(member, truth, loose=True) for member in texts)
    return "yes" if right else "no", seconds, ended, to_text(texts[-1])[:60] if texts else ""


def read_solutions(folder: Path, names: Sequence[str]) -> list[Any]:
    """Give the formulas of aifeynman's front as it stands, the best last."""
    from dynsr.expression import parse

    files = sorted(folder.glob("results/solution_*data.txt"), key=os.path.getmtime)
    lines = files[-1].read_text().splitlines() if files else []
    found = []
    for text in (line.split()[-1] for line in lines if line.split()):
        for place, name in enumerate(names):
            text = text.replace(f"x{place}", name)
        with suppress(ValueError):
            found.append(parse(text, names))
    return found


def main() -> None:
    """Make the environment, go into it, run, print and write."""
    options = read_options()
    if Path(sys.prefix).resolve() != HOME.resolve():
        python = make_home()
        raise SystemExit(subprocess.run([python, __file__, *sys.argv[1:]], check=False).returncode)
    records, notes = run(options)
    parts = [
        f"{options.systems} systems of the zoo, drawn with seed {options.seed}.\n",
        table_of(records).to_markdown(),
        *(f"{note}\n" for note in notes),
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    if not options.no_aifeynman:
        parts.append(show_aifeynman(options.out))
    text = "\n".join(parts)
    (options.out / "peers.md").write_text(text, encoding="utf-8")
    (options.out / "notes.json").write_text(json.dumps(notes), encoding="utf-8")
    if options.page is not None:
        from zoo import write_page

        write_page(options.page, text, (BEGIN, END))
    print(text)


if __name__ == "__main__":
    main()
