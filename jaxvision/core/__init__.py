"""Internal foundations: types, vectors, NaN-safe numerics, random numbers, checks of arguments,
printing of records, memory, and worker processes.

Modules whose names begin with an underscore are for `jaxvision` alone; `fitting` may use the others
too. Only loops over pixels, rays and records use `_loops`.
"""
