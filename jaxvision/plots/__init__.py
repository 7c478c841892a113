"""Plot results: images, spectra, reflection lobes, curves with their intervals, errors against
time, and posteriors with the true values. An image is plotted as five views (as in Szeliski,
Computer Vision, fig. 3.3), as a picture, in false colours, or as a histogram.

Plots cannot be traced by JAX, and take NumPy arrays. matplotlib is loaded on first use. Values are
in DN for integer images, and relative for floating-point images. Data that cannot be plotted raise
`InputError` with a message of one sentence. A plot with a single axes has an argument `axes`, which
takes axes of any matplotlib figure.

A figure that a plotting function makes is not registered with `matplotlib.pyplot`, because pyplot
keeps figures in memory until they are closed. So `plt.show()` does not show such a figure, and
`plt.savefig` writes an empty page. A notebook shows a figure that is the last value of a cell. In a
script, write `axes.figure.savefig("plot.png")`, or `figure.savefig` if the plot returns a figure.
To see a plot in a window, pass axes made by pyplot:

    axes = jv.plots.lobe(material, axes=plt.subplot(projection="polar")); plt.show()
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
