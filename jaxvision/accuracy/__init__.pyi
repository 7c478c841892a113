# What `jaxvision.accuracy` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .choice import choose as choose
from .curves import curve as curve, error_against_time as error_against_time
from .examples import example as example
from .knobs import KNOBS as KNOBS
from .norms import relative_rms as relative_rms
from .pages import page as page, write_page as write_page
from .plots import front as front, plot as plot
from .records import (
    Curve as Curve,
    Knob as Knob,
    Order as Order,
    Problem as Problem,
    Reference as Reference,
    Trial as Trial,
)
from .scenes import knobs_of as knobs_of, scene_problem as scene_problem
from .scene_settings import (
    Chosen as Chosen,
    measured as measured,
    measured_together as measured_together,
    settings as settings,
)
from .rounding import Digits as Digits, digits as digits
from .several import Combination as Combination, combined as combined
from .tables import notes as notes, rows as rows
