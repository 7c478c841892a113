"""Photon transfer of one camera at several gains and temperatures, in one fit.

setting         flats and darks of a rig, setting by setting, and the estimates of each
statement       the laws of gain and temperature as a `Problem`, and their tests
calibration     everything together, with full well and fixed pattern averaged over settings
sensor          the camera at any gain and temperature
findings        every sentence of a report, with its condition
figures section what else a report shows
"""
