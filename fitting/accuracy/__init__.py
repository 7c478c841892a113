"""Measure error against time for each approximation in `fitting`, on the user's own rig.

    knobs                 every approximation by name; those without a rig have an example
    noise response brdf   the problems of the three fits of a rig
    examples              the problems of the other approximations
    chains                posteriors by Laplace, emcee and NUTS, at several chain lengths
    rigs                  the fits of a rig, and the curves of their settings

The quantities compared are the ends and the middle of each parameter's interval, in standard errors
of the fit without approximation. An error of 10 % is thus a tenth of a standard error.
`jaxvision.accuracy` computes the curves of error against time, chooses the cheapest settings and
writes the pages.
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
