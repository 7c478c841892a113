"""Internal foundations: types, vectors, NaN-safe numerics, random numbers, argument checks,
printing of records, and execution on the machine.

Modules whose names begin with an underscore are for `jaxvision` alone, and the others also for
`fitting`. `_loops` is for loops over pixels, rays and records only.
"""
