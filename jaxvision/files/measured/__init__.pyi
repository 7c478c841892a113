# What `jaxvision.files.measured` offers, each name where it is defined; see
# `jaxvision/__init__.pyi`.

from .by_suffix import read_measured as read_measured
from .cornell import read_cornell as read_cornell, write_cornell as write_cornell
from .merl import read_merl as read_merl, write_merl as write_merl
from .rgl import read_rgl as read_rgl, write_rgl as write_rgl
from .scattered import table_of_samples as table_of_samples
