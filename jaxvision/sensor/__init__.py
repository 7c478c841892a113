"""Conversion of light on a sensor to digital numbers: photons, electrons, noise, gain and ADC.

The model is the linear model of EMVA 1288, with further effects of real CCD and CMOS sensors. There
is one file for each stage, in the order in which light and charge pass through the sensor:

    sampling -> exposure -> dark -> shot_noise -> ccd -> mixing -> nonlinearity -> fixed_pattern
    -> read_out -> adc

`raw` combines the stages for one exposure. `moments` computes mean, variance and covariances in
closed form, and `expectation` estimates other expectations. `shutter` averages a moving scene over
the exposure. An effect whose parameter is None is not traced. `Sensor` and the records of its
effects are in `jaxvision.scene`.

Electron counts are differentiated by a reparameterisation (see `shot_noise`). The derivative of
rounding is defined as 1, and the derivative is 0 where a value is clipped. Gradients of means and
mean squares of raw data are therefore unbiased if the noise exceeds 1 DN. Each stage lists the
terms that its gradient neglects. The page "Gradients of noise" gives the size of the errors.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
