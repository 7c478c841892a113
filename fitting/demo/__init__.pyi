# What `fitting.demo` offers, each name where it is defined.

from .lab import Truth as Truth, simulate_lab as simulate_lab
from .section import against_truth as against_truth
