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
from .illumination import Source as Source
from .pruning import inspect as inspect, prune as prune
from .reflection import Lobe as Lobe, Reflection as Reflection
from .size import equations as equations
from .stages import Ends as Ends
