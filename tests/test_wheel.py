import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = ("DynSR.jl", "integrate.jl", "regress.jl", "release2021.jl", "workload.jl")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Build the wheel of this checkout, with the builder that is installed."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel; pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (found,) = folder.glob("dynsr-*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """Install the wheel alone into an empty folder."""
    folder = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(folder), str(wheel)], check=True, capture_output=True)
    return folder


def run_in(site: Path, code: str, folder: Path) -> str:
    """Run code in a Python that finds dynsr in the installed place alone, far from the checkout."""
    setup = f"import sys; sys.path.insert(0, {str(site)!r}); "
    done = subprocess.run(
        [sys.executable, "-I", "-c", setup + code],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_the_wheel_holds_all_that_dynsr_needs_at_run_time(wheel):
    """Julia's sources, the list of its packages, the marker of types and the recorded answers."""
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = {f"dynsr_julia/src/{name}" for name in SOURCES}
    wanted |= {f"dynsr_julia/{name}" for name in ("juliapkg.json", "Project.toml")} | {
        "dynsr/py.typed"
    }
    assert wanted <= names
    here = {p.relative_to(ROOT).as_posix() for p in (ROOT / "dynsr").rglob("*") if p.is_file()}
    assert {n for n in here if "__pycache__" not in n} <= names


@pytest.mark.slow
def test_the_sdist_gives_the_same_wheel(wheel, tmp_path):
    """The archive of the sources, unpacked elsewhere, builds a wheel of the very same files."""
    build = [sys.executable, "-m", "hatchling", "build"]
    command = [*build, "-t", "sdist", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (archive,) = tmp_path.glob("dynsr-*.tar.gz")
    with tarfile.open(archive) as sources:
        sources.extractall(tmp_path, filter="data")
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert {"pyproject.toml", "README.md", "LICENSE"} <= {path.name for path in folder.iterdir()}
    command = [*build, "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    (again,) = tmp_path.glob("dynsr-*.whl")
    files = [
        {info.filename: info.CRC for info in zipfile.ZipFile(path).infolist()}
        for path in (wheel, again)
    ]
    assert files[0] == files[1]


@pytest.mark.slow
def test_an_installed_dynsr_finds_julias_sources(installed, tmp_path):
    """Away from the checkout, the engine finds the folder beside the package."""
    code = "from dynsr.engines.julia.setup import find_sources; print(find_sources())"
    found = Path(run_in(installed, code, tmp_path))
    assert found == installed / "dynsr_julia"
    assert all((found / "src" / name).is_file() for name in SOURCES)


@pytest.mark.slow
def test_juliapkg_would_find_the_list_of_packages(installed, tmp_path):
    """The list lies where juliapkg looks: in one folder, directly below a place of the path."""
    code = (
        "import json, pathlib, sys; "
        "found = {f for p in sys.path for f in pathlib.Path(p).glob('dynsr*/juliapkg.json')}; "
        "(path,) = found; "
        "print(*sorted(json.loads(path.read_text())['packages']))"
    )
    found = run_in(installed, code, tmp_path)
    assert found == "DataDrivenDiffEq DataDrivenSparse DynSR OrdinaryDiffEqTsit5 PythonCall"


def test_a_checkout_has_one_list_of_packages():
    """An editable install leaves no copy beside it, whose path would contradict the first."""
    found = {file for path in sys.path for file in Path(path or ".").glob("*/juliapkg.json")}
    assert [file.resolve() for file in found] == [ROOT / "julia" / "juliapkg.json"]


@pytest.mark.parametrize("where", ["checkout", "wheel"])
def test_juliapkg_develops_the_julia_package(installed, where):
    """The path of its entry, taken from the list's folder, holds the package of that name."""
    import json
    import re

    package = ROOT / "julia" if where == "checkout" else installed / "dynsr_julia"
    listed = json.loads((package / "juliapkg.json").read_text())["packages"]["DynSR"]
    assert listed["dev"] is True
    project = (package / listed["path"] / "Project.toml").read_text()
    assert re.search(r'^name = "DynSR"$', project, re.MULTILINE)
    assert f'\nuuid = "{listed["uuid"]}"' in project
    assert (package / listed["path"] / "src" / "DynSR.jl").is_file()


@pytest.mark.slow
def test_an_installed_dynsr_integrates(installed, tmp_path):
    """The wheel alone is a working dynsr."""
    code = (
        "from dynsr.data.system import PENDULUM; from dynsr.engines.simulation import simulate; "
        "print(simulate(PENDULUM).x.shape)"
    )
    assert run_in(installed, code, tmp_path) == "(1001, 2)"


def test_the_lists_of_julia_packages_agree():
    """juliapkg.json and Project.toml ask for the same packages, versions and Julia."""
    import json
    import re

    listed = json.loads((ROOT / "julia" / "juliapkg.json").read_text())
    project = (ROOT / "julia" / "Project.toml").read_text()
    for name in ("DataDrivenDiffEq", "DataDrivenSparse", "OrdinaryDiffEqTsit5"):
        entry = listed["packages"][name]
        assert f'{name} = "{entry["uuid"]}"' in project
        assert f'{name} = "{entry["version"]}"' in project
    assert f'julia = "{listed["julia"]}"' in project
    deps = re.search(r"\[deps\]\n(.*?)\n\n", project, re.DOTALL)
    bounds = re.search(r"\[compat\]\n(.*?)\n\n", project, re.DOTALL)
    assert deps and bounds
    for line in deps[1].splitlines():
        assert re.search(rf"^{line.split(' ')[0]} = ", bounds[1], re.MULTILINE)
