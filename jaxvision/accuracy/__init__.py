"""Measure error against time for each approximation of the library, on the user's own problem, and
choose settings by the measurement.

A `Knob` is a parameter of an approximation that trades error for time, such as a number of samples.
A setting is one value of a knob.

- `records` defines the records of knobs, problems, measurements and curves.
- `curves` measures error against time within a time budget, with `session` for timing, `reference`
  for the reference result, `norms` for the errors and `fitted` for the order of convergence.
- `choice` chooses the setting of one knob, and `several` the settings of all knobs together.
- `knobs` lists all approximations of the library, and `examples` has a problem for each.
- `scenes` makes a problem of a scene file, and `scene_settings` chooses its settings.
- `rounding` counts the digits of a function's results that float32 rounding leaves correct.
- `tables`, `plots` and `pages` present the measurements.

Compiled, pure functions cannot measure time. So measure first, choose settings, and then call the
library with these settings.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
