"""Set-up: which environment a script makes, and what it says while it does."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="the scripts are of a POSIX shell")


@pytest.fixture
def checkout(tmp_path):
    """Give a checkout whose Python makes an environment, and whose pip writes down what it gets."""
    for name in ("pyproject.toml", "scripts/environment", "scripts/constraints.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "scripts" / "downloaded.py", tmp_path / "scripts")
    fake = tmp_path / "bin" / "python3"
    fake.parent.mkdir()
    made = f"""mkdir -p .venv/bin
cat > .venv/bin/python <<'END'
#!/bin/sh
case "$1" in
-m) echo "$*" >> "{tmp_path}/log"
  case "$*" in *progress-bar*) echo "Progress 5000000 of 5000000";; esac;;
*) exec "{sys.executable}" "$@";;
esac
END
chmod +x .venv/bin/python"""
    fake.write_text(f"""#!/bin/sh
case "$1" in
-c) exit 0;;
--version) echo Python 3.12.1;;
*) {made};;
esac
""")
    fake.chmod(0o755)

    def call(*words, **more):
        hidden = ("VIRTUAL_ENV", "DYNSR_USE_ACTIVE_ENV", "PYTHON")
        environment = {k: v for k, v in os.environ.items() if k not in hidden}
        environment |= {"PATH": f"{fake.parent}:{os.environ['PATH']}", **more}
        (tmp_path / "log").unlink(missing_ok=True)
        done = subprocess.run(
            [tmp_path / "scripts" / "environment", *words],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        log = tmp_path / "log"
        return done.stdout, done.stderr, log.read_text() if log.exists() else ""

    return call


def test_a_replication_needs_little_and_tests_need_all(checkout):
    """Each asks pip for its extras, once; an environment for tests serves a replication too."""
    _, said, asked = checkout("replicate")
    assert "about 300 MB are downloaded" in said and ".[torch]" in asked and ".[dev]" not in asked
    assert checkout("replicate")[1:] == ("", "")
    _, said, asked = checkout()
    assert "about 790 MB" in said and ".[dev]" in asked
    assert checkout()[1:] == checkout("replicate")[1:] == ("", "")


def test_torch_comes_without_cuda_unless_it_is_asked_for(checkout):
    """On Linux the index of builds without CUDA is asked first; DYNSR_TORCH=cuda leaves it out."""
    if sys.platform != "linux":
        pytest.skip("on other systems the build of PyPI has no CUDA")
    assert "download.pytorch.org/whl/cpu torch" in checkout("replicate", DYNSR_TORCH="cpu")[2]


def test_cuda_is_had_on_request(checkout):
    """With DYNSR_TORCH=cuda torch is what PyPI has."""
    assert "pytorch.org" not in checkout("replicate", DYNSR_TORCH="cuda")[2]


def test_only_the_path_is_printed(checkout):
    """What a script reads is the path alone; all that is said goes to a reader."""
    out, said, _ = checkout("replicate")
    assert out.endswith("/.venv/bin/python\n") and out.count("\n") == 1
    assert [line.strip()[:6] for line in said.splitlines()[1:]] == ["1 of 3", "2 of 3", "3 of 3"]
