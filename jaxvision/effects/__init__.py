"""Bound the change that each effect makes in a picture, and drop negligible effects.

    certificate   the records: effects, tolerances, and the dropped effects with their bounds
    stages        the interface of a stage of the camera
    pruning       `inspect` and `prune`
    choice        the choice of the effects to drop
    boxes         the range of the free parameters of a fit
    seconds       the measured time of each effect
    radiance      the effects of a scene: lights, shadows, lobes, emission, ambient light
    extent        the effects of area lights
    bounces       the effects of paths
    spectra       the effects of bands
    probes        estimates of the light of long paths
    sums          bounds on the light of each part of a scene, from `illumination`, `reflection`,
                  `angles`, `blocking`, `umbra`, `cells` and `bodies`

The bounds are computed in NumPy float64 outside `jit`; records with traced numbers are refused.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
