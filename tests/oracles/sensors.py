"""A sensor with every effect at once, and the same for light given in photons, which tests of a
whole sensor vary by `replace`."""

from dataclasses import replace

import numpy as np

from jaxvision import scene as s
from jaxvision.sensor.colour_filters import bayer

EVERY_EFFECT = s.Sensor(
    photon_conversion=s.PhotonConversion([6e-7, 5e-7, 4e-7], 1e-11),
    light_offset=30.0,
    infrared_cut=[0.9, 1.0, 1.0],
    exposure_time=0.02,
    quantum_efficiency=0.5,
    colour_filter=s.ColourFilter(np.eye(3), pattern=bayer("RGGB")),
    pixel_aperture=s.PixelAperture(0.5),
    crosstalk=0.03,
    smear=1e-4,
    prnu=0.02,
    dead_pixels=1e-3,
    dark_current=s.DoublingDarkCurrent(500.0, 303.0, 293.0, 8.0),
    hot_pixels=s.HotPixels(0.02, 2000.0),
    shot_noise=s.FastPoissonShotNoise(),
    brighter_fatter=s.BrighterFatter([[2e-6, 5e-7]], steps=3),
    full_well=1e4,
    blooming=0.5,
    charge_transfer=s.ChargeTransfer(1e-4, trail=3),
    mixing=s.Mixing([[0.0, 0.02, 0.0], [0.01, 0.93, 0.01], [0.0, 0.03, 0.0]]),
    nonlinearity=s.Compression(0.05, 0.01, electrons=1e4),
    conversion_prnu=0.015,
    dsnu=3.0,
    column_dsnu=1.5,
    row_dsnu=1.0,
    reset_noise=s.ResetNoise(1e-16, 300.0),
    read_noise=s.HeavyTailedReadNoise(3.0, 12.0, 0.05),
    telegraph_noise=s.TelegraphNoise(0.1, 8.0),
    row_noise=1.0,
    column_noise=0.8,
    frame_noise=0.5,
    banding=s.Banding(2.0, 7.0),
    column_prnu=0.01,
    gain=0.6,
    offset=100.0,
    taps=s.Taps(((0, 1),), offset=[0.0, 2.0], gain=[1.0, 1.02], read_noise=[1.0, 1.2]),
    bits=14,
)
OF_PHOTONS = replace(
    EVERY_EFFECT,
    photon_conversion=None,
    infrared_cut=None,
    colour_filter=None,
    pixel_aperture=None,
)
