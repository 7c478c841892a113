"""The output of a calibration: the section of its results, shown in a terminal, in a notebook or on
a page."""
