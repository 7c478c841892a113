"""The output of a calibration: a section with its results, shown in a terminal, in a notebook or on
an HTML page."""
