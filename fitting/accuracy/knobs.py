"""List every approximation of `fitting` by name, like `jaxvision.accuracy.KNOBS` for rendering."""

from collections.abc import Mapping

from jaxvision.accuracy import Knob

_OF_RIGS = (
    Knob(
        "solver tolerance",
        "fall in cost",
        "predicted decrease of the cost at which a search for the mode ends",
        (1.0, 1e-1, 1e-2, 1e-3, 1e-5, 1e-7),
        (1e-9, 1e-11),
        sets=("*.minimise*.tolerance", "*.max_steps"),
    ),
    Knob(
        "pixels",
        "of all",
        "a random part of the pixels instead of all",
        (0.03, 0.1, 0.3),
        (1.0,),
        random=True,
    ),
    Knob(
        "cells",
        "of the usual width",
        "cells of similar pixels instead of single pixels; the result is exact at the mode found",
        (8.0, 4.0, 2.0, 1.0, 0.5, 0.25),
        ("pixels",),
        sets=("*.group.width", "*.make_grid.width"),
    ),
    Knob(
        "likelihood",
        "",
        "likelihood of means and variances: regressions, Gaussian, or exact for rounded codes",
        ("moments", "gaussian", "exact"),
        ("exact",),
        sets=("*.noise_data.window", "*.NoiseData.window", "*.SensorCounts.reach"),
    ),
    Knob(
        "posterior",
        "",
        "Gaussian about the mode, or draws by NUTS or emcee",
        ("laplace", "nuts", "emcee"),
        (),
        random=True,
        sets=("*.sampling", "*.fit.posterior"),
    ),
    Knob(
        "chain length",
        "steps",
        "largest number of steps of emcee's ensemble of 64 walkers",
        (50, 100, 200, 400, 800),
        (1600, 3200),
        order=-0.5,
        random=True,
        sets=("*Options.steps", "*Options.walkers", "*.Emcee.steps", "*.Emcee.walkers"),
    ),
    Knob(
        "NUTS draws",
        "of each of 4 chains",
        "length of the chains of NUTS",
        (25, 100, 400, 1000),
        (4000,),
        order=-0.5,
        random=True,
        sets=("*.Nuts.draws", "*.Nuts.chains", "*.Nuts.acceptance"),
    ),
    Knob(
        "code bins",
        "bins",
        "intervals of codes at which a response curve is known",
        (16, 32, 64, 128, 256, 512),
        (1024,),
        sets=("*.code_bins.count", "*.fit_response_curve.most_bins"),
    ),
    Knob(
        "curve rounds",
        "rounds",
        "largest number of updates of smoothness and shutter errors of a response curve",
        (1, 2, 4, 8, 15, 30),
        (60,),
        sets=("*.solve.rounds", "*.fit_response_curve.rounds"),
    ),
)
_APART = (
    Knob(
        "Laplace draws",
        "draws",
        "draws from the Gaussian about the mode",
        (100, 400, 1600, 4000),
        (25_600, 102_400),
        order=-0.5,
        random=True,
        whole=True,
        sets=("*.laplace.draws",),
    ),
    Knob(
        "starts",
        "searches",
        "searches from starts spread over bounds and priors; the best optimum is kept",
        (1, 2, 4, 8, 16),
        (32, 64),
        random=True,
        sets=("*.fit.starts", "*.spread_starts.count", "*.search.starts", "*.fit_map.starts"),
    ),
)

KNOBS: Mapping[str, Knob] = {knob.name: knob for knob in (*_OF_RIGS, *_APART)}
RIG_KNOBS = tuple(knob.name for knob in _OF_RIGS)
