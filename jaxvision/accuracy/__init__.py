"""What accuracy costs in time: error against time for any knob, on the user's own problem, and the
cheapest settings that suffice.

    records          knobs, problems, trials, curves
    curves           `curve` measures within a budget; `session` times, `reference` makes the truth,
                     `norms`, `spread` and `fitted` say how far off, within what, by what order
    choice several   `choose` one setting; `combined`: those of several knobs at once
    knobs examples   every approximation of the library by name, and a problem for each
    scenes           scene files as problems; `scene_settings`: their settings for a tolerance
    tables plots pages   what is shown; `together`: all knobs at once, checked

Timing is eager and stays outside pure functions: measure, choose, then call.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
