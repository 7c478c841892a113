"""Results drawn: an image as five views (Szeliski, Computer Vision, fig. 3.3), as a picture, a map
in false colour or a histogram; spectra and lobes; curves with their bands, errors against time, and
posteriors beside the truth.

This is the edge of the library: eager, NumPy in, with matplotlib loaded on first use. Values are DN
(integer images) or relative (floating images). What cannot be shown raises `InputError`, one
sentence. Each plot of one axes takes `axes=`, of `matplotlib.pyplot.subplots` or any figure.

Figures that are made here are not known to `matplotlib.pyplot`, which would keep each of them until
it is closed: `plt.show()` does not show them, and `plt.savefig` writes an empty page. A notebook
shows what a cell returns. In a script write `axes.figure.savefig("plot.png")`, or `figure.savefig`
where a figure is returned; for a window give the axes of pyplot:

    axes = jv.plots.lobe(material, axes=plt.subplot(projection="polar")); plt.show()
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
