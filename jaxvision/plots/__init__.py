"""Plots of results: images (as five views as in Szeliski, Computer Vision, fig. 3.3, as a picture,
in false colour, or as a histogram), spectra and lobes, curves with their bands, errors against
time, and posteriors with the true values.

Plots are eager and take NumPy arrays. matplotlib is loaded on first use. Values are DN (integer
images) or relative (floating images). Data that cannot be shown raise `InputError` with one
sentence. Each plot of one axes takes `axes=`, from `matplotlib.pyplot.subplots` or any figure.

Figures made here are not registered with `matplotlib.pyplot`, which would keep each of them until
it is closed. So `plt.show()` does not show them, and `plt.savefig` writes an empty page. A notebook
shows the value of a cell. In a script write `axes.figure.savefig("plot.png")`, or `figure.savefig`
if a figure is returned. For a window, pass the axes of pyplot:

    axes = jv.plots.lobe(material, axes=plt.subplot(projection="polar")); plt.show()
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
