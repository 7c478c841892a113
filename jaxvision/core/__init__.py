"""Internal foundations: types, vectors, NaN-safe numerics, random numbers, checks of arguments,
printing of records, memory, and worker processes.

Only `jaxvision` uses modules whose names begin with an underscore. The package `fitting` may also
use the other modules. Only code that loops over pixels, rays or records uses `_loops`.
"""
