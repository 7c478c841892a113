# What `fitting.study` offers, each name where it is defined; see `fitting/__init__.pyi`.

from .compare import Compared as Compared, Drift as Drift
from .outcomes import Outcome as Outcome, Settings as Settings
from .run import Study as Study, study as study
