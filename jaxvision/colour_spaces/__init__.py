"""Colour spaces: conversions of arrays whose last axis is the three components.

RGB is linear and relative (1 is white) unless a name says otherwise. XYZ has Y = 1 at the white. L*
of Lab and Luv runs from 0 to 100. The hue of LCh is an angle in rad in [0, 2 pi). The hue of HSV
and HSL is a fraction of a full turn, in [0, 1). Nothing is clipped. Colours outside a gamut survive
a conversion and its inverse. The exceptions, all with components outside [0, 1], are colours whose
largest component is 0 in HSV, and colours of lightness 0 or 1 in HSL.

Values and gradients are finite at and near black, white and every grey. At these colours the hue is
undefined and set to 0, with gradient 0. A divisor below `smallest_divisor` (3e-10 in float32)
counts as 0. Darker colours have no chromaticity and no saturation, and colours closer to grey have
no hue in HSV and HSL. Arrays whose last axis is not 3, and arrays of integer codes, raise a
`ValueError`. Matrices are chosen by their name in `colour_data`, a static option. The functions
multiply by them without `@`, which is slow over an axis of three.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
