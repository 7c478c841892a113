"""Conversion of light on a sensor to digital numbers: photons, electrons, noise, gain and ADC.

The model is the linear model of EMVA 1288, extended by further effects of real CCD and CMOS
sensors. Each stage has its own file, in the order of the light's path:

    sampling -> exposure -> dark -> shot_noise -> ccd -> mixing -> nonlinearity -> fixed_pattern
    -> read_out -> adc

`raw` composes them for one exposure, `moments` gives mean, variance and covariances in
closed form, `expectation` estimates expectations of anything else, and `shutter` averages a moving
scene over the exposure. A parameter of the sensor that is None is not traced. `Sensor` and the
records of its effects are in `jaxvision.scene`.

Counts are differentiated along the draw (see `shot_noise`), and rounding has slope 1. Clipping has
gradient 0. Gradients of means and mean squares of raw data are therefore unbiased if the noise
exceeds 1 DN. Each stage names the terms that its gradient neglects. The page "Gradients of noise"
has the figures.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
