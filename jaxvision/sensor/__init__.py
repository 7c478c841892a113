"""Light on a sensor to digital numbers: photons, electrons, noise, charge, gain and ADC.

The linear model of EMVA 1288, extended by the further effects of real CCD and CMOS sensors. Each
stage has its own file, in the order of the light's path:

    sampling -> exposure -> dark -> shot_noise -> ccd -> fixed_pattern -> read_out -> adc

`raw` composes them for one exposure, `moments` gives mean and variance in closed form, and
`shutter` averages a moving scene over the exposure. A parameter of the sensor that is None is not
traced.

Exact Poisson draws and rounding have the gradients of their expectations. Gaussian draws are
differentiated along the draw itself, so their gradients are noisy near 0 electrons. Clipping has
gradient 0.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
