"""Photon transfer of one camera at several gains and temperatures, in one fit.

setting         one setting's estimates of the shared quantities
read            flats and darks of a rig, setting by setting
statement       the laws of gain and temperature as a `Problem`, and their tests
pooled          full well and fixed pattern, averaged over settings
calibration     everything together
sensor          the camera at any gain and temperature
findings        every sentence of a report, with its condition
figures section what else a report shows
"""
