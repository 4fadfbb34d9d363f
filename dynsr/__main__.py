"""``python -m dynsr`` is the ``dynsr`` command."""

from dynsr.cli import main

if __name__ == "__main__":
    main()
