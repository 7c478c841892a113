"""Only the effects that a scene calls for: what each can change in a picture, and what to drop.

    certificate   the records: effects, tolerances, and what was dropped with its bound
    stages        how a stage of the camera plugs in
    pruning       `inspect` and `prune`; `choice` decides, `boxes` reads what a fit may change,
                  `seconds` measures what each effect takes
    radiance      the rows of a scene: lights, shadows, lobes, emission, ambient light; `extent`,
                  `bounces` and `spectra` those of area lights, of paths and of bands; `probes`
                  estimates what long paths add
    sums          what each part of a scene sends at most, from `illumination`, `reflection`,
                  `angles`, `blocking`, `umbra`, `cells` and `bodies`

NumPy in float64, outside `jit`: records with traced numbers are refused.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
