"""What the accuracy of a fit costs in time: a knob for each approximation of `fitting`, turned on
the reader's own rig.

    knobs                 every approximation by name; what has no rig has an example of its own
    noise response brdf   the problems of the three fits of a rig, and `examples` of the others
    chains                posteriors by Laplace, emcee and NUTS, and their lengths
    rigs                  which fits a rig holds, and the curves of their knobs

Results are ends and middles of intervals in units of the standard error of the whole fit: an error
of 10 % is a tenth of a standard error. Curves, choice and pages are those of `jaxvision.accuracy`.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
