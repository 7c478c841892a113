"""Error against time for each approximation of `fitting`, measured on the user's own rig.

    knobs                 every approximation by name; those without a rig have an example
    noise response brdf   the problems of the three fits of a rig
    examples              the problems of the other approximations
    chains                posteriors by Laplace, emcee and NUTS, and their lengths
    rigs                  the fits of a rig, and the curves of their knobs

Results are the ends and middles of intervals, in units of the standard error of the whole fit. An
error of 10 % is a tenth of a standard error. Curves, choice and pages come from
`jaxvision.accuracy`.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
