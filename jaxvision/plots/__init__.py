"""Plot results: images (five views as in Szeliski, Computer Vision, fig. 3.3, a picture, false
colours, or a histogram), spectra and lobes, curves with their intervals, errors against time, and
posteriors with the true values.

Plots cannot be traced by JAX, and take NumPy arrays. matplotlib is loaded on first use. Values are
in DN for integer images, and relative for floating-point images. Data that cannot be plotted raise
`InputError` with a message of one sentence. Each plot with a single axes takes `axes=`, made by
`matplotlib.pyplot.subplots` or by any figure.

A figure that is made here is not registered with `matplotlib.pyplot`, which would keep it in memory
until it is closed. So `plt.show()` does not show such a figure, and `plt.savefig` writes an empty
page. A notebook shows a figure that is the last value of a cell. In a script, write
`axes.figure.savefig("plot.png")`, or `figure.savefig` if the plot returns a figure. To see a plot
in a window, pass axes made by pyplot:

    axes = jv.plots.lobe(material, axes=plt.subplot(projection="polar")); plt.show()
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
