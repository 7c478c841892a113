"""Where was the lamp?

The lamp's position is estimated, with its uncertainty, from a noisy picture of a matte ball. The
plot shows the posterior of two coordinates by Laplace's approximation (68 and 95 % regions) and the
true position.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np
from corner import hist2d

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, fit

ball = jv.Surface(jv.Sphere((0, 0, 0), 1.0), jv.Lambert([0.2]))
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.2 / 24, resolution=(24, 24))


def picture(x, z):
    lamp = jv.PointLight(jax.numpy.stack([x, 1.0, z]), (20.0,))
    return jv.render(jv.Scene([ball], [lamp]), view)[..., 0]


data = picture(-1.0, 2.5) + 0.05 * jax.random.normal(jax.random.key(0), (24, 24))
unknown = {"x": Parameter(lower=-4, upper=4), "z": Parameter(lower=1.5, upper=5)}
result = fit(Problem(unknown, picture, Gaussian(sd=0.05), data=data))
hist2d(result.draws["x"], result.draws["z"], levels=(0.68, 0.95), plot_datapoints=False)
plt.plot(-1.0, 2.5, "o", color="tab:red", label="truth")
plt.xlabel("x of the lamp [m]")
plt.ylabel("z of the lamp [m]")
plt.legend(loc="lower right")
