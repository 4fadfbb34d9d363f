"""Formats: the one table of what equations are written as."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from dynsr.data import check_new, write_new
from dynsr.errors import InputError, need, say_near
from dynsr.export import documents, models, programs, sbml
from dynsr.export.reactions import find_reactions
from dynsr.export.source import Source, Words, name_in


@dataclass(frozen=True)
class Format:
    """One format.

    Parameters
    ----------
    title : what it is.
    suffix : of its file.
    write : writes it from a source.
    words : what its language allows as a name; None where any will do.
    maps : whether it can express a map.
    needs : (module, extra) that it is written with; None where nothing is needed.
    check : raises InputError where it cannot express the equations.
    folder : writes it where it is several files: name -> text.
    delays : whether it can express states as they were some time before; a delayed input is an
        input for all of them.
    """

    title: str
    suffix: str
    write: Callable[[Source], str]
    words: Words | None = None
    maps: bool = False
    needs: tuple[str, str] | None = None
    check: Callable[[Source], object] | None = None
    folder: Callable[[Source], dict[str, str]] | None = None
    delays: bool = False


FORMATS: dict[str, Format] = {
    "python": Format(
        "Python with NumPy", ".py", programs.write_python, programs.PYTHON, True, delays=True
    ),
    "torch": Format("PyTorch module", ".py", programs.write_torch, programs.TORCH, True),
    "jax": Format("JAX, for diffrax", ".py", programs.write_jax, programs.PYTHON),
    "c": Format("C99", ".c", programs.write_c, programs.C, True),
    "fortran": Format("Fortran", ".f90", programs.write_fortran, programs.FORTRAN, True),
    "matlab": Format(
        "MATLAB and Octave", ".m", programs.write_matlab, programs.MATLAB, True, delays=True
    ),
    "r": Format("R, for deSolve", ".R", programs.write_r, programs.R, True, delays=True),
    "julia": Format("Julia", ".jl", programs.write_julia, programs.JULIA, True, delays=True),
    "modelingtoolkit": Format(
        "ModelingToolkit.jl", ".jl", models.write_modelingtoolkit, models.MODELINGTOOLKIT
    ),
    "catalyst": Format(
        "Catalyst.jl", ".jl", models.write_catalyst, models.CATALYST, check=find_reactions
    ),
    "modelica": Format("Modelica", ".mo", models.write_modelica, models.MODELICA, delays=True),
    "sbml": Format("SBML", ".xml", sbml.write_sbml, sbml.SBML, needs=("libsbml", "sbml")),
    "petab": Format(
        "PEtab problem with the data",
        "",
        sbml.write_sbml,
        sbml.SBML,
        needs=("libsbml", "sbml"),
        check=sbml.check_petab,
        folder=sbml.write_petab,
    ),
    "casadi": Format("CasADi", ".py", models.write_casadi, models.CONTROL, True),
    "control": Format("python-control", ".py", models.write_control, models.CONTROL, True),
    "do-mpc": Format("do-mpc", ".py", models.write_do_mpc, models.CONTROL, True),
    "latex": Format("LaTeX with a table", ".tex", documents.write_latex, None, True, delays=True),
    "mathml": Format("MathML", ".html", documents.write_mathml, None, True, delays=True),
    "markdown": Format("Markdown table", ".md", documents.write_markdown, None, True, delays=True),
    "bibtex": Format(
        "BibTeX of the methods", ".bib", documents.write_bibtex, None, True, delays=True
    ),
}
ALIASES = {
    "numpy": "python",
    "octave": "matlab",
    "diffrax": "jax",
    "pytorch": "torch",
    "mtk": "modelingtoolkit",
}


def find_format(name: str) -> Format:
    """Give a format by its name.

    Parameters
    ----------
    name : of :data:`FORMATS`, or another word for one of them.

    Raises InputError that lists the names when there is none.

    >>> find_format("octave").title
    'MATLAB and Octave'
    """
    asked = ALIASES.get(name.lower(), name.lower())
    if asked not in FORMATS:
        hint = say_near(asked, [*FORMATS, *ALIASES])
        raise InputError(f"unknown format {name!r}{hint}; the formats are: {', '.join(FORMATS)}")
    return FORMATS[asked]


def list_formats(source: Source) -> dict[str, Format]:
    """Give the formats that can hold equations with what is installed here, by their names.

    Parameters
    ----------
    source : the equations, and what goes with them.

    >>> from dynsr.data import find_system
    >>> "catalyst" in list_formats(Source.of(find_system("lorenz")))
    False
    """
    found = {}
    for name, one in FORMATS.items():
        with suppress(InputError):
            _choose(source, name)
            found[name] = one
    return found


def name_file(name: str) -> str:
    """Give the name of the one file of a format.

    Parameters
    ----------
    name : of the format.

    >>> name_file("petab")
    'found_petab.zip'
    """
    # A file of Python that had the name of what it imports would import itself.
    return f"found_{name.replace('-', '_')}{find_format(name).suffix or '.zip'}"


def pack_format(source: Source, name: str) -> tuple[str, bytes]:
    """Write equations in a format as one file, a folder as a ZIP archive; gives its name too.

    Parameters
    ----------
    source : the equations, and what goes with them.
    name : of the format.

    Raises InputError as :func:`write_files` does.

    >>> from dynsr.data import find_system
    >>> pack_format(Source.of(find_system("sir")), "do-mpc")[0]
    'found_do_mpc.py'
    """
    texts = write_files(source, name)
    if find_format(name).folder is None:
        (text,) = texts.values()
        return name_file(name), text.encode()
    packed = BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for file, text in texts.items():
            # The same equations give the same bytes.
            archive.writestr(ZipInfo(file), text)
    return name_file(name), packed.getvalue()


def write_files(source: Source, name: str) -> dict[str, str]:
    """Write equations in a format: name of each file -> its text.

    Parameters
    ----------
    source : the equations, and what goes with them.
    name : of the format.

    Raises InputError when there is no such format or it cannot express these equations,
    MissingExtra when what writes it is not installed.

    >>> from dynsr.data import find_system
    >>> sir = Source.of(find_system("sir"))
    >>> list(write_files(sir, "markdown"))
    ['found.md']
    """
    chosen = _choose(source, name)
    named = source
    if chosen.words is not None:
        named = name_in(source.written_out, chosen.words, chosen.write)
    if chosen.folder is not None:
        return chosen.folder(named)
    return {f"found{chosen.suffix}": chosen.write(named)}


def _choose(source: Source, name: str) -> Format:
    chosen = find_format(name)
    if source.system.discrete and not chosen.maps:
        able = ", ".join(key for key, one in FORMATS.items() if one.maps)
        raise InputError(f"{chosen.title} takes no map; formats that do: {able}")
    if not chosen.delays:
        source.refuse_delays(chosen.title, [key for key, one in FORMATS.items() if one.delays])
    if chosen.needs is not None:
        need(*chosen.needs, f"the format {name!r}")
    if chosen.check is not None:
        chosen.check(source.written_out)
    return chosen


def write_format(source: Source, name: str) -> str:
    """Write equations in a format of one file.

    Parameters
    ----------
    source : the equations, and what goes with them.
    name : of the format.

    Raises InputError also when the format is several files.
    """
    if _choose(source, name).folder is not None:
        raise InputError(f"{name!r} is several files; give a folder for them")
    (text,) = write_files(source, name).values()
    return text


def save_format(source: Source, name: str, path: Path, force: bool = False) -> list[Path]:
    """Write equations in a format to a file, or to a folder where it is several; gives the files.

    Parameters
    ----------
    source : the equations, and what goes with them.
    name : of the format.
    path : the file, or the folder.
    force : whether files that are there are replaced.

    Raises InputError as :func:`write_files` does, and where a file is there or cannot be written.
    """
    texts = write_files(source, name)
    files = {path: next(iter(texts.values()))}
    if find_format(name).folder is not None:
        files = {path / file: text for file, text in texts.items()}
    for file in files:
        check_new(file, force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        next(iter(files)).parent.mkdir(exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot write {str(path)!r}: {reason}; choose another place") from None
    for file, text in files.items():
        write_new(file, text, force)
    return list(files)
