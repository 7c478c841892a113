"""The `jaxvision-fit` command, `python -m fitting`. An interrupt also ends it during its
imports."""

from importlib import import_module

from jaxvision.core.interrupts import ending_on_interrupt


def main() -> None:
    """Entry point."""
    ending_on_interrupt("jaxvision-fit", lambda: import_module("fitting.cli").start())


if __name__ == "__main__":
    main()
