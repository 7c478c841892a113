"""Many folders calibrated alike, and their results as one table.

outcomes   one folder: calibrated, reported, remembered
table      all folders as one xarray data set
compare    outliers among cameras, drift with date or temperature
page       the comparison as a page with links to each report
run        from paths to all of these, on one process or many
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
