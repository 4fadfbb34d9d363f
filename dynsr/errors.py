"""What can go wrong, as one tree.

::

    DynsrError
    ├── InputError          what the user gave cannot be used (exit code 2)
    │   └── MissingExtra        what was asked for needs a package that is not installed
    └── EngineError         an engine failed at what it was asked
        └── EngineUnavailable   the engine asked for is not installed (exit code 2)

    DynsrWarning            the input was usable only after a change that the message names
"""

from __future__ import annotations

import errno
import json
import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import cache
from importlib.util import find_spec
from unicodedata import category

# Torch and Julia have no class of their own for it.
_OF_MEMORY = re.compile(r"allocate memory|not enough memory|OutOfMemory|out of memory|bad_alloc")


class DynsrError(Exception):
    """Root of every error that dynsr raises on purpose."""

    def __str__(self) -> str:
        """Give the message; a name or a cell that it shows steers no terminal."""
        return printable(super().__str__(), "\n")


class InputError(DynsrError, ValueError):
    """What the user gave cannot be used; the message names the value and the remedy in one line."""

    def __str__(self) -> str:
        """Give the message; a value that it shows may be an array of several lines."""
        return one_line(super().__str__())


class MissingExtra(InputError):
    """What was asked for needs an optional package; the message has the command to install it."""


class EngineError(DynsrError, RuntimeError):
    """An engine failed at what it was asked; the message has the engine's own words."""


class EngineUnavailable(EngineError):
    """The engine asked for is not there; the message says how to get it."""


class DynsrWarning(UserWarning):
    """The input was usable only after a change, or looks wrong; the message names it."""

    def __str__(self) -> str:
        """Give the message on one line; a name or a cell that it shows steers no terminal."""
        return one_line(super().__str__())


def say_near(name: object, names: Iterable[str]) -> str:
    """Ask in brackets whether the nearest of some names was meant; nothing where none is near.

    Parameters
    ----------
    name : what was given.
    names : what there is.

    >>> say_near("pray", ["prey", "hunters"]), say_near("k", ["prey"])
    (" (did you mean 'prey'?)", '')
    """
    near = get_close_matches(str(name), list(names), 1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def printable(text: str, keep: str = "", escaped: Callable[[str], str] = ascii) -> str:
    r"""Give a text as a terminal may show it, whoever wrote it.

    Signs that end a line, steer a terminal, turn the direction of reading, are not seen or are no
    characters at all become escapes; spaces stay.

    Parameters
    ----------
    text : the text.
    keep : signs that stay too.
    escaped : gives the escape of a sign between two quotation marks.

    >>> print(printable("a\x1b[31m\u202e b\udcff"))
    a\x1b[31m\u202e b\udcff
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in keep or category(c) == "Zs" else escaped(c)[1:-1] for c in text
    )


def one_line(message: object) -> str:
    r"""Give a message or an exception's words with all white space as single spaces.

    >>> one_line("too\n   few rows")
    'too few rows'
    """
    return printable(" ".join(str(message).split()))


def quoted(text: object) -> str:
    """Give what a user wrote as it is quoted in a message: in quotation marks, and not too long.

    Parameters
    ----------
    text : what was given; of a longer text the first 60 letters.

    >>> quoted("no such method"), len(quoted("x" * 100))
    ("'no such method'", 62)
    """
    return repr(str(text)[:60])


def in_words(error: BaseException) -> str:
    """Give the one line that a user reads of what ended a command or a job.

    Parameters
    ----------
    error : what was raised; one that is no DynsrError, of the system or of memory is our fault.

    >>> in_words(InputError("too few rows; give more"))
    'too few rows; give more'
    >>> in_words(MemoryError())
    'there is not enough memory; give fewer rows, a smaller search or fewer jobs'
    >>> in_words(ZeroDivisionError("by zero"))
    'this is a fault in dynsr: ZeroDivisionError: by zero (DYNSR_DEBUG=1 shows where)'
    """
    if isinstance(error, DynsrError):
        return one_line(error)
    if is_of_memory(error):
        asked = one_line(error)
        said = f" ({asked})" if asked else ""
        return f"there is not enough memory{said}; give fewer rows, a smaller search or fewer jobs"
    if isinstance(error, OSError):
        where = f" {str(error.filename)!r}" if error.filename else ""
        return one_line(f"cannot use{where}: {error.strerror or error}")
    fault = f"this is a fault in dynsr: {type(error).__name__}: {error}"
    return one_line(f"{fault} (DYNSR_DEBUG=1 shows where)")


def is_of_memory(error: BaseException) -> bool:
    """Whether an error says that the memory did not suffice, as each library says it.

    Parameters
    ----------
    error : what was raised.

    >>> is_of_memory(RuntimeError("DefaultCPUAllocator: can't allocate memory: 12 bytes"))
    True
    """
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    told = isinstance(error, RuntimeError) and _OF_MEMORY.search(str(error)) is not None
    return told or isinstance(error, MemoryError)


def need(module: str, extra: str, user: str) -> None:
    """Check that an optional package is installed, without importing it.

    Parameters
    ----------
    module : the package's import name.
    extra : the extra of dynsr that installs it.
    user : what needs it, as the subject of the message.

    Raises MissingExtra, with the command to install it, when it is not there.

    >>> need("sympy", "all", "a formula")
    >>> need("no_such_package", "all", "a wonder")
    Traceback (most recent call last):
    ...
    dynsr.errors.MissingExtra: a wonder needs no_such_package: pip install "...[all]"...
    """
    try:
        there = find_spec(module) is not None
    # A package may be blocked: None in sys.modules, or a finder that refuses.
    except (ImportError, ValueError):
        there = False
    if not there:
        raise MissingExtra(f"{user} needs {module}: {say_install(extra)}")


def say_install(extra: str) -> str:
    """Give the command that adds an extra to this dynsr, from where it was installed.

    Parameters
    ----------
    extra : the extra of dynsr.

    >>> say_install("torch")
    'pip install "...[torch]"...'
    """
    source = _installed_from()
    if source is None:
        return f'pip install "dynsr[{extra}]"'
    if source.startswith("file:"):
        return f'pip install ".[{extra}]" in the checkout of dynsr'
    return f'pip install "dynsr[{extra}] @ {source}"'


@cache
def _installed_from() -> str | None:
    """Give the address that dynsr was installed from; None where it came from an index by name.

    pip writes it down (PEP 610). What nobody installed runs from its checkout.
    """
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        text = distribution("dynsr").read_text("direct_url.json")
    except PackageNotFoundError:
        return "file:"
    found = json.loads(text) if text else {}
    system = found.get("vcs_info", {}).get("vcs", "")
    return f"{system}+{found['url']}" if system else found.get("url")
