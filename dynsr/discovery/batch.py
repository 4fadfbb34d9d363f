"""Batch: one discovery for each of many files, in parallel, and one table of them all."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.data import Columns, check_replaceable, is_own_page, load_with_doses
from dynsr.discovery.orders import write_lines
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.errors import DynsrError, InputError, one_line
from dynsr.jobs import (
    REPORT,
    RunFolder,
    Step,
    Task,
    Watch,
    check_jobs,
    fingerprint,
    read_manifest,
    read_record,
    run_tasks,
    to_plain,
)
from dynsr.methods import Report
from dynsr.verdict import NOT_FOUND

# Level of a file in which nothing could be searched.
FAILED = "failed"
# Folder of each file's own discovery, in that of the batch.
EACH = "each"
_WORK = "batch"
# Rough seconds of a file on one core, from which the time left is first guessed.
_USUAL = 60.0


@dataclass(frozen=True)
class Discovered:
    """What was found in one file.

    Parameters
    ----------
    file : its path, as it was given.
    level : that of the verdict; "failed" where nothing could be searched.
    reason : why, in words.
    equations : the equations, a line each.
    seconds : wall time.
    complete : whether the search came to its end.
    folder : that of its discovery and its report, from the folder of the batch; None where there
        is none.
    constants : the constants, a line each: state, term, value and 95 % interval.
    """

    file: str
    level: str
    reason: str
    equations: tuple[str, ...]
    seconds: float
    complete: bool = True
    folder: str | None = None
    constants: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """What was found, in a few words."""
        return f"{self.level}: {'; '.join(self.equations) or self.reason}"

    @property
    def done(self) -> bool:
        """Whether the same call has nothing more to do."""
        return self.complete and self.level != FAILED


def discover_each(
    files: Sequence[str | Path],
    out: str | Path,
    *,
    jobs: int = -1,
    progress: Callable[[Step], None] | None = None,
    dose_table: str | Path | None = None,
    report: bool = True,
    **settings: Any,
) -> list[Discovered]:
    """Find the equations of each of many files, which are no runs of one system.

    Parameters
    ----------
    files : tables, one system each.
    out : a folder that keeps what was found in each, by the name of its file in ``each``. The same
        call on it continues where it stopped; files may be added, and those that have changed are
        searched again.
    jobs : files at a time; -1 for one per core. The joblib backend in force is used, so
        ``joblib.parallel_config("dask")`` spreads them over a cluster.
    progress : called with a :class:`Step` as files end, and every half second in between.
    dose_table : a table of the doses of all files, as :func:`dynsr.add_doses` takes it. A column
        ``file`` names the file of each dose.
    report : write the report of each discovery, and a page and a table of all files,
        ``report.html`` and ``discoveries.csv`` in ``out``.
    settings : of :func:`discover`, the same for all files.

    Gives one record for each file, in their order. A file that cannot be used has a record that
    says why, and the others go on. A worker that dies is replaced. Raises InputError when no file
    is given, one is given twice, or the folder is another batch's.

    >>> import tempfile
    >>> import numpy as np
    >>> from dynsr.data import Trajectory, write_csv
    >>> t = np.linspace(0, 3, 61)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_csv(Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",)), f"{folder}/decay.csv")
    ...     found = discover_each([f"{folder}/decay.csv"], f"{folder}/out", jobs=1, preset="quick")
    ...     sorted(path.name for path in Path(f"{folder}/out").iterdir())
    ['discoveries.csv', 'each', 'manifest.json', 'records', 'report.html']
    >>> found[0].level, found[0].equations
    ('law', ("x' = -0.5*x",))
    """
    if not files:
        raise InputError("no file was given; give at least one")
    twice = [str(file) for file, often in Counter(map(Path, files)).items() if often > 1]
    if twice:
        raise InputError(f"file {twice[0]!r} is given twice; give it once")
    folder = RunFolder(Path(out).absolute())
    # Workers of a cluster may be in other folders.
    places = tuple(Path(file).absolute() for file in files)
    given = _Doses(Path(dose_table).absolute(), places) if dose_table is not None else None
    shared = {"version": __version__, "settings": fingerprint(repr(to_plain(settings)))}
    folder.claim(_WORK, shared, alone=(EACH,))
    assert folder.path is not None
    check_replaceable(folder.path / REPORT, is_own_page)
    tasks = [
        _make_task(Path(file), name, folder.path / EACH / name, settings, given, report)
        for file, name in zip(files, _names([Path(file) for file in files]), strict=True)
    ]
    workers = effective_n_jobs(check_jobs(jobs))
    with Watch(progress, {task.name: task.seconds for task in tasks}, workers) as watch:
        rows = run_tasks(tasks, folder, jobs, watch, finished=lambda record: record.done)
    if report:
        from dynsr.report import write_batch

        write_batch(rows, folder.path)
    return rows


def read_batch(folder: str | Path) -> list[Discovered]:
    """Read what a batch found up to now, by the names of the files.

    Parameters
    ----------
    folder : the one that :func:`discover_each` was given as ``out``.

    Raises InputError when no file is finished, RecordError when a record is damaged or the folder
    is no batch's.
    """
    read_manifest(Path(folder), _WORK)
    places = sorted((Path(folder) / RunFolder.records).glob("[!.]*.json"))
    rows = [read_record(place, Discovered)[0] for place in places]
    if not rows:
        raise InputError(f"{str(folder)!r} has no finished file; run the batch first")
    return sorted(rows, key=lambda row: row.file)


def _names(files: Sequence[Path]) -> list[str]:
    """Give each file a name of its own: that of the file, with a number where others have it."""
    seen: Counter[str] = Counter()
    found = []
    for file in files:
        seen[file.stem] += 1
        found.append(file.stem if seen[file.stem] == 1 else f"{file.stem}-{seen[file.stem]}")
    return found


@dataclass(frozen=True)
class _Doses:
    """The doses of a batch.

    Parameters
    ----------
    table : of the doses.
    files : of the measurements, which the table may name.
    """

    table: Path
    files: tuple[Path, ...]


def _make_task(
    file: Path,
    name: str,
    out: Path,
    settings: Mapping[str, Any],
    doses: _Doses | None,
    page: bool,
) -> Task:
    read = [file] if doses is None else [file, doses.table]
    content = [own.read_bytes() if own.is_file() else b"" for own in read]
    key = fingerprint(*content, repr(to_plain(dict(settings))), __version__)
    arguments = (
        str(file),
        file.absolute(),
        out.with_name(f"{out.name}-{key}"),
        dict(settings),
        doses,
        page,
    )
    died = partial(_died, file)
    return Task(name, str(file), discover_one, arguments, Discovered, key, _USUAL, died)


def _died(file: Path, reason: str) -> Discovered:
    """Give the record of a file whose process died: the others go on."""
    return Discovered(str(file), FAILED, reason, (), 0.0)


def discover_one(
    name: str,
    file: Path,
    out: Path,
    settings: Mapping[str, Any],
    doses: _Doses | None,
    page: bool,
    report: Report,
) -> Discovered:
    """Find the equations of one file of a batch.

    Parameters
    ----------
    name, file : the table as it was asked for, and where it is.
    out : the folder of its discovery.
    settings : of :func:`discover`.
    doses : their table, where there is one.
    page : whether the report of the discovery is written.
    report : hears of the search.
    """
    began = time.monotonic()
    try:
        data, used = (file, settings) if doses is None else _with_doses(file, settings, doses)
        found = discover(data, out=out, jobs=1, progress=False, **used)
        if page and found.complete:
            found.report(out / REPORT)
    except (DynsrError, MemoryError) as error:
        reason = one_line(error) or type(error).__name__
        return Discovered(name, FAILED, reason, (), time.monotonic() - began)
    lines = tuple(write_lines(found.equations, found.settings))
    taken = time.monotonic() - began
    level, reason = found.verdict.level, found.verdict.reason
    where = f"{EACH}/{out.name}" if page and found.complete else None
    constants = () if level == NOT_FOUND else tuple(_constants(found))
    return Discovered(name, level, reason, lines, taken, found.complete, where, constants)


def _constants(found: Discovery) -> Iterator[str]:
    """Write the constants that were fitted, a line each."""
    for state, own in found.constants.items():
        for one in own:
            if not one.fixed:
                yield f"{state}', {one.of}: {one.text}"


def _with_doses(
    file: Path, settings: Mapping[str, Any], doses: _Doses
) -> tuple[Columns, dict[str, Any]]:
    asked = (settings.get(name) for name in ("doses", "time", "trajectory", "decimal"))
    columns, given = load_with_doses([file], doses.table, *asked, others=doses.files)
    return columns[0], {**settings, "doses": given}
