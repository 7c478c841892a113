"""Run the `jaxvision-fit` command (`python -m fitting`). A keyboard interrupt ends the command even
while it imports its modules.
"""

from importlib import import_module

from jaxvision.core.interrupts import ending_on_interrupt


def main() -> None:
    """Run the command."""
    ending_on_interrupt("jaxvision-fit", lambda: import_module("fitting.cli").start())


if __name__ == "__main__":
    main()
