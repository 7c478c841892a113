"""How many entries a loop takes at a time: few on a processor, whose cache then holds them."""

from jaxvision.programs import on_processor

_OF_KERNEL = 128  # times as many on an accelerator, where every operation has the cost of a launch


def at_a_time(of_core: int) -> int:
    """The number of entries that a loop takes at a time: `of_core` on a processor, many more
    elsewhere."""
    return of_core if on_processor() else of_core * _OF_KERNEL
