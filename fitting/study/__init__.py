"""Calibrate many folders, with the results in one table.

outcomes   one folder: its calibration, report and stored result
table      all folders as one xarray data set
compare    outliers among cameras, drift with date or temperature
page       the comparison as a page with links to each report
run        from paths to all of these, on one process or many
"""

from jaxvision.core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
