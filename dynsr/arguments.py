"""Arguments of another type than a function takes, named in one line at the public door.

The annotations are the only list of what each takes. They are looked at only when something has
gone wrong within: a call that goes well costs nothing more, and what works though nobody has
foreseen it, such as a set where a sequence is due, still works.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import itertools
import numbers
import os
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any, TypeVar, get_args, get_origin
from warnings import warn

from dynsr.errors import DynsrError, InputError, one_line

T = TypeVar("T", bound=Callable[..., Any])
C = TypeVar("C")
# Of long sequences the first are looked at.
_MOST = 100
_SEVERAL = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_ROWS: tuple[type, ...] = (range, type({}.keys()), type({}.values()))
_WORDS: dict[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "text",
    None: "None",
    types.NoneType: "None",
    Callable: "a function",
}
_PLURALS = {"a whole number": "whole numbers", "a number": "numbers", "text": "texts"}


def checked(door: T) -> T:
    """Have a public function, or a class and its public methods, name an argument of a wrong type.

    What they raise that is no error of dynsr becomes an InputError where an argument is not of the
    type that its annotation says; else it stays as it is.

    Parameters
    ----------
    door : the function or class.

    >>> @checked
    ... def double(number: float) -> float:
    ...     return number + number.real
    >>> double("two")
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: double takes number as a number, not 'two' (str)
    """
    if not isinstance(door, type):
        return typing.cast("T", _guarded(door, door.__name__))
    for name, member in list(vars(door).items()):
        public = isinstance(member, types.FunctionType) and not name.startswith("_")
        if name == "__init__" or public:
            said = door.__name__ if name == "__init__" else f"{door.__name__}.{name}"
            setattr(door, name, _guarded(member, said))
        elif isinstance(member, (classmethod, staticmethod)) and not name.startswith("_"):
            inner = _guarded(member.__func__, f"{door.__name__}.{name}")
            setattr(door, name, type(member)(inner))
    return door


def _warn_renamed(old: str, new: str) -> None:
    """Warn whoever uses what calls this of a name of before."""
    words = f"{old} is now {new}; the old name ends next release"
    warn(words, DeprecationWarning, stacklevel=3)


class Renamed:
    """A public name of before, which gives what has another name now, and says so.

    Parameters
    ----------
    new : the name now.
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        """Note the name of before."""
        self.old = name

    def __get__(self, found: Any, owner: type) -> Any:
        """Give what the new name gives; warns of the old one."""
        if found is None:
            return self
        _warn_renamed(f"{owner.__name__}.{self.old}", self.new)
        return getattr(found, self.new)


def renamed_exports(module: str, find: Callable[[str], Any], **names: str) -> Callable[[str], Any]:
    """Give the ``__getattr__`` of a module that still knows names of before, with a warning.

    Parameters
    ----------
    module : its name.
    find : gives what the module exports by its name.
    names : name of before -> the name now.

    >>> find = renamed_exports("pens", {"Pen": 1}.__getitem__, Quill="Pen")
    >>> find("Pen")
    1
    """

    def found(name: str) -> Any:
        if name not in names:
            return find(name)
        _warn_renamed(f"{module}.{name}", names[name])
        return find(names[name])

    return found


def moved_exports(find: Callable[[str], Any], *rooms: str) -> Callable[[str], Any]:
    """Give the ``__getattr__`` of a module that gives what now is in other modules, too.

    Parameters
    ----------
    find : gives what the module exports by its name; raises AttributeError for others.
    rooms : names of the modules that export the rest.

    >>> from types import SimpleNamespace
    >>> moved_exports(SimpleNamespace(pen=1).__getattribute__, "string")("digits")
    '0123456789'
    """

    def found(name: str) -> Any:
        try:
            return find(name)
        except AttributeError:
            for room in map(import_module, rooms):
                if name in room.__all__:
                    return getattr(room, name)
            raise

    return found


def renamed(**names: str) -> Callable[[type[C]], type[C]]:
    """Let a class take arguments by their names of before for one release, with a warning.

    Parameters
    ----------
    names : name of before -> the name now.

    >>> @renamed(colour="color")
    ... class Pen:
    ...     def __init__(self, color):
    ...         self.color = color
    >>> Pen.names_before
    {'colour': 'color'}
    """

    def rename(kind: Any) -> Any:
        begin = kind.__init__

        @functools.wraps(begin)
        def begun(self: Any, *arguments: Any, **named: Any) -> None:
            for old in names.keys() & named.keys():
                _warn_renamed(f"{kind.__name__}({old}=)", f"{names[old]}=")
                named[names[old]] = named.pop(old)
            begin(self, *arguments, **named)

        kind.__init__ = begun
        kind.names_before = names
        for old, new in names.items():
            alias = Renamed(new)
            alias.__set_name__(kind, old)
            setattr(kind, old, alias)
        return kind

    return rename


def _guarded(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def guarded(*arguments: Any, **named: Any) -> Any:
        try:
            return function(*arguments, **named)
        except DynsrError:
            raise
        except Exception as error:
            if isinstance(error, TypeError) and (unknown := _say_unknown(function, name, named)):
                raise TypeError(unknown) from None
            said = _say_misfit(function, name, arguments, named)
            if said is None:
                raise
            raise InputError(said) from error

    return guarded


def _say_unknown(function: Callable[..., Any], name: str, named: Mapping[str, Any]) -> str | None:
    """Say which keyword a function does not take, and what was meant; None where it takes all."""
    kinds = inspect.signature(function).parameters
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in kinds.values()):
        return None
    for given in named:
        if given not in kinds:
            own = [key for key in kinds if key not in ("self", "cls")]
            near = get_close_matches(given, own, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it takes: {', '.join(own)}"
            return f"{name}() got an unexpected keyword argument {given!r}; {hint}"
    return None


def _say_misfit(
    function: Callable[..., Any], name: str, arguments: Sequence[Any], named: Mapping[str, Any]
) -> str | None:
    """Say which argument is of another type than its annotation; None where none is."""
    signature = inspect.signature(function)
    try:
        given = signature.bind(*arguments, **named).arguments
    except TypeError:
        # Python has said it already: too many arguments, or one of an unknown name.
        return None
    kinds = _annotations(function)
    for argument, value in given.items():
        several = signature.parameters[argument].kind in _SEVERAL
        kind = Any if several or argument == "self" else kinds.get(argument, Any)
        if not fits(value, kind):
            shown = one_line(repr(value))
            shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
            return (
                f"{name} takes {argument} as {expected(kind)}, not {shown} ({type(value).__name__})"
            )
    return None


class _Names(dict[str, Any]):
    """What the names in annotations stand for; Any for what only type checkers import."""

    def __init__(self, known: Mapping[str, Any]) -> None:
        super().__init__()
        self.known = known

    def __missing__(self, name: str) -> Any:
        return self.known[name] if name in self.known else vars(builtins).get(name, Any)


def _annotations(function: Callable[..., Any]) -> dict[str, Any]:
    known = getattr(inspect.unwrap(function), "__globals__", {})
    try:
        return typing.get_type_hints(function, None, _Names(known))
    except TypeError:
        return {}


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of a type, as annotations name types.

    Parameters
    ----------
    value : any value; of long sequences the first hundred are looked at.
    kind : a type, also one of several or of parts. Whole numbers are numbers, and what NumPy makes
        an array of is one.

    >>> fits([1, 2], Sequence[int]), fits("12", Sequence[str]), fits(3, str | None)
    (True, False, False)
    """
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is typing.Literal:
        return any(value is one or (type(value) is type(one) and value == one) for one in inner)
    kind = origin or kind
    if kind is None:
        return value is None
    if not isinstance(kind, type) or kind in (Any, object):
        return True
    if issubclass(kind, (str, bytes)) or not _is_of_parts(kind):
        return _is_plain(value, kind)
    if issubclass(kind, Mapping):
        return isinstance(value, Mapping) and _parts_fit(value, inner)
    if isinstance(value, (str, bytes, Mapping)):
        return False
    if issubclass(kind, (tuple, list, Sequence)):
        row = isinstance(value, (Sequence, *_ROWS)) or hasattr(value, "__array__")
        return row and _parts_fit(value, inner)
    return isinstance(value, Iterable) and _parts_fit(value, inner)


def _is_of_parts(kind: type) -> bool:
    """Whether a type is one of mappings, sequences or anything else that is gone through."""
    return kind.__module__ in ("builtins", "collections.abc") and issubclass(kind, Iterable)


def _is_plain(value: Any, kind: type) -> bool:
    if kind in (bool, int, float):
        return _is_number(value, kind)
    if kind.__name__ == "ndarray":
        return hasattr(value, "__array__") or _is_table(value)
    return callable(value) if kind.__name__ == "Callable" else isinstance(value, kind)


def _is_number(value: Any, kind: type) -> bool:
    is_truth = isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")
    if kind is bool or is_truth:
        return kind is bool and is_truth
    if kind is int:
        return isinstance(value, numbers.Integral)
    plain = hasattr(value, "__float__") and not hasattr(value, "__len__")
    return isinstance(value, numbers.Real) or plain


def _is_table(value: Any) -> bool:
    """Whether lists in lists hold numbers alone, in rows of one length."""
    if not isinstance(value, (list, tuple)):
        return False
    rows = [len(row) for row in value if isinstance(row, (list, tuple))]
    if rows:
        even = len(rows) == len(value) and len(set(rows)) == 1
        return even and all(map(_is_table, value[:_MOST]))
    return all(_is_number(one, float) or hasattr(one, "__array__") for one in value[:_MOST])


def _parts_fit(value: Any, kinds: Sequence[Any]) -> bool:
    if isinstance(value, Mapping):
        pairs = list(value.items())[:_MOST]
        return not kinds or all(fits(k, kinds[0]) and fits(v, kinds[1]) for k, v in pairs)
    known = isinstance(value, (list, tuple, set, frozenset)) or hasattr(value, "__array__")
    # An iterator would be empty behind it.
    if not kinds or not known:
        return True
    if Ellipsis in kinds or len(kinds) == 1:
        return all(fits(part, kinds[0]) for part in itertools.islice(value, _MOST))
    return len(kinds) == len(value) and all(map(fits, value, kinds))


def expected(kind: Any) -> str:
    """Give a type in words.

    >>> expected(str | Sequence[int] | None)
    'text, a sequence of whole numbers or None'
    """
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (typing.Union, types.UnionType):
        *words, last = dict.fromkeys(map(expected, inner))
        return f"{', '.join(words)} or {last}" if words else last
    if origin is typing.Literal:
        return " or ".join(map(repr, inner))
    plain = origin or kind
    if plain in _WORDS or plain is Any or not isinstance(plain, type):
        return _WORDS.get(plain, "anything")
    if issubclass(plain, os.PathLike):
        return "a path"
    if not _is_of_parts(plain):
        return f"{'an' if plain.__name__[0] in 'AEIOU' else 'a'} {plain.__name__}"
    parts = [_plural(part) for part in inner if part is not Ellipsis]
    if issubclass(plain, Mapping):
        return f"a mapping of {parts[0]} to {parts[1]}" if len(parts) > 1 else "a mapping"
    fixed = issubclass(plain, tuple) and len(parts) > 1
    what = " and ".join(map(expected, inner)) if fixed else " or ".join(parts)
    return f"a sequence of {what}" if what else "a sequence"


def _plural(kind: Any) -> str:
    words = expected(kind)
    return _PLURALS.get(words, words)
