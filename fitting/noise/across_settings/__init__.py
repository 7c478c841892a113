"""Photon transfer of one camera at several gains and temperatures, in one fit.

setting         what one setting tells of the quantities that settings share
read            flats and darks of a rig, setting by setting
statement       the laws of gain and temperature as a `Problem`, and which of them hold
pooled          full well and fixed pattern, averaged over settings
calibration     everything together
sensor          the camera at any gain and temperature
findings        every sentence of a report, with its condition
figures section what else a report shows
"""
