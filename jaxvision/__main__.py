"""The `jaxvision` command, `python -m jaxvision`. An interrupt (Ctrl-C) ends the command even while
it is still importing."""

from importlib import import_module

from .core.interrupts import ending_on_interrupt


def main() -> None:
    """Entry point."""
    ending_on_interrupt("jaxvision", lambda: import_module("jaxvision.cli").start())


if __name__ == "__main__":
    main()
