"""What can go wrong, as one tree.

::

    DynsrError
    ├── InputError          what the user gave cannot be used (exit code 2)
    └── EngineError         an engine failed at what it was asked
        └── EngineUnavailable   the engine asked for is not installed (exit code 2)

    DynsrWarning            the input was usable only after a change that the message names
"""


class DynsrError(Exception):
    """Root of every error that dynsr raises on purpose."""


class InputError(DynsrError, ValueError):
    """What the user gave cannot be used; the message names the value and the remedy in one line."""


class EngineError(DynsrError, RuntimeError):
    """An engine failed at what it was asked; the message holds the engine's own words."""


class EngineUnavailable(EngineError):
    """The engine asked for is not there; the message says how to get it."""


class DynsrWarning(UserWarning):
    """The input was usable only after a change, or looks wrong; the message names it."""
