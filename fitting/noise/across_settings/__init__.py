"""One fit to the photon transfer of a camera at several gains and temperatures.

setting         the flats and darks of each setting, and their estimates
statement       the laws of gain and temperature as a `Problem`, with tests of the laws
calibration     all fits of a camera, with full well and fixed pattern averaged over settings
sensor          the camera as a sensor at any gain and temperature
prediction      prediction of levels that were held out of the fit
findings        the sentences of a report, each with its condition
figures         the figures of a report
section         the report, with its estimates and tables
"""
