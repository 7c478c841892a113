# What `import fitting` offers, each name where it is defined: read by type checkers, and by
# `__init__.py`, which loads a name when it is first used.

from . import (
    joint as joint,
    lights as lights,
    noise as noise,
    reflectance as reflectance,
    resolution as resolution,
    response as response,
    sensitivities as sensitivities,
)
from .fits.bands import (
    Bands as Bands,
)
from .fits.budget import (
    Budget as Budget,
)
from .fits.called_for import (
    called_for as called_for,
)
from .fits.influence import (
    Influence as Influence,
    influence as influence,
)
from .checks.problem import (
    Check as Check,
    check as check,
)
from .fits.map import (
    FitMap as FitMap,
)
from .fits.pixels import (
    fit_map as fit_map,
)
from .fits.result import (
    Fit as Fit,
)
from .fits.solve import (
    fit as fit,
)
from .inference.candidates import (
    Candidate as Candidate,
    Choice as Choice,
)
from .inference.channels import (
    stack_channels as stack_channels,
)
from .inference.design import (
    Plan as Plan,
)
from .inference.emcee_run import (
    Emcee as Emcee,
    SamplingOptions as SamplingOptions,
)
from .inference.estimates import (
    Estimate as Estimate,
)
from .inference.joint_prior import (
    JointPrior as JointPrior,
    as_prior as as_prior,
)
from .inference.likelihoods import (
    Censored as Censored,
    Clustered as Clustered,
    Gaussian as Gaussian,
    StudentT as StudentT,
)
from .inference.nuts import (
    Nuts as Nuts,
    NutsOptions as NutsOptions,
)
from .inference.parameters import (
    Parameter as Parameter,
)
from .inference.posterior import (
    Laplace as Laplace,
)
from .inference.priors import (
    Gamma as Gamma,
    HalfNormal as HalfNormal,
    LogNormal as LogNormal,
    Normal as Normal,
    Uniform as Uniform,
)
from .inference.problem import (
    Problem as Problem,
    Tied as Tied,
)
from .inference.problem import (
    InputError as InputError,
)
from .sensor_likelihoods import (
    SensorCounts as SensorCounts,
    SensorNoise as SensorNoise,
)
