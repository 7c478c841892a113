"""Photon transfer of one camera at several gains and temperatures, in one fit.

setting         of one setting, what it tells of the quantities that settings share
read            flats and darks of a rig, setting by setting
model           the laws of gain and temperature
fit             generalised least squares, and which claims of the model hold
pooled          full well and fixed pattern, averaged over settings
calibration     everything together
sensor          the camera at any gain and temperature
findings figures section    what a report says and shows
"""
