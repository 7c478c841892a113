# What `jaxvision.effects` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .certificate import (
    Certificate as Certificate,
    Effect as Effect,
    Pruned as Pruned,
    Tolerance as Tolerance,
    explain as explain,
    parse as parse,
)
from .development import lipschitz as lipschitz
from .pruning import inspect as inspect, prune as prune
from .size import equations as equations
