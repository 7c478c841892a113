"""Measurement of error against time for each approximation, on the user's own problem, and the
choice of its settings.

A `Knob` is the setting of an approximation, such as a number of samples.

    records          the records of knobs, problems, trials and curves
    curves           `curve` measures error against time within a budget of time
    session          times the calls of a problem
    reference        computes the reference result
    norms            norms of errors, and bounds on that of another seed
    rounding         digits that rounding leaves, and the operation that loses them
    fitted           the measured order of convergence
    choice several   choose one setting, or a combination that fresh runs check
    knobs examples   every approximation of the library by name, and a problem for each
    scenes           scene files as problems; `scene_settings`: their settings for a tolerance
    tables plots pages   output

Timing cannot happen inside compiled, pure functions: measure first, choose settings, then call the
library with them.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
