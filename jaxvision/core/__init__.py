"""What every room stands on and no user needs to know: types, vectors, NaN-safe numbers, random
numbers, checks of arguments, how records print, and how work runs on the machine.

Modules whose names begin with an underscore are for `jaxvision` alone, the others for `fitting`
too. `_loops` holds what only loops over pixels, rays and records use.
"""
