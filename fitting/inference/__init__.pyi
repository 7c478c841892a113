# What `fitting.inference` offers, each name where it is defined; see `fitting/__init__.pyi`.

from .clustering import Robustness as Robustness, cluster_robust as cluster_robust
from .estimates import find as find
from .formatting import (
    format_interval as format_interval,
    format_name as format_name,
    format_unit as format_unit,
    format_value as format_value,
)
from .importance import laplace_where_it_holds as laplace_where_it_holds
