"""Bound the change that each effect makes in a picture, and drop negligible effects.

- `certificate` defines the records of effects, tolerances and dropped effects.
- `pruning` contains `inspect`, which lists effects, and `prune`, which drops them.
- `choice` decides which effects to drop, and `seconds` measures the time that each effect takes.
- `radiance`, `extent` and `bounces` bound the effects of a scene: of lights and materials, of the
  size of lamps, and of long light paths. `probes` estimates the light of long paths.
- `spectra` bounds the error of rendering fewer bands.
- `optics`, `motion`, `sensor` and `development` bound the effects of a camera.
- `sums` bounds the light of each part of a scene, on which the other bounds rest.

The bounds are computed in NumPy float64 outside `jit`. Records with traced numbers raise
`ValueError`.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
