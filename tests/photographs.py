"""Photographs with headers that state how they were taken."""

from fractions import Fraction

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational


def photograph(path, *, seconds, iso=100, f_number=4.0, taken="2026:05:04 12:30:00", code=90):
    """Write a JPEG with EXIF by Pillow."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "Maker", "Maker Model 3"
    time = IFDRational(Fraction(seconds).limit_denominator(1000))
    exif[0x8769] = {
        0x829A: time,
        0x829D: IFDRational(10 * f_number, 10),
        0x8827: iso,
        0x9003: taken,
    }
    Image.fromarray(np.full((8, 10, 3), code, np.uint8)).save(path, exif=exif)
