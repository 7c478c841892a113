"""A joint fit to the photon transfer of a camera at several gains and temperatures.

- `setting` reduces the flats and darks of each setting to estimates.
- `statement` has the laws of gain and temperature as a `Problem`, with tests of these laws.
- `calibration` makes all fits of a camera, and averages full well and fixed pattern over settings.
- `sensor` converts a calibrated camera to a sensor at any gain and temperature.
- `prediction` predicts light levels that were left out of the fit.
- `findings` has the sentences of a report, each with the condition under which it is reported.
- `figures` and `section` make the figures and the section of a report.
"""
