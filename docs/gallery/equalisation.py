"""Equalisation, whole and local

Codes are mapped by the cumulative distribution of the whole picture, or of each of 8 x 8 tiles with
a contrast limit (CLAHE). Both results equal OpenCV's except for differences of one level.
"""

import matplotlib.pyplot as plt
from skimage import data

from jaxvision.histogram import equalise, equalise_locally, exact_histogram

photo = data.moon()[::2, ::2]
pictures = {"as it is": photo, "equalised": equalise(photo), "locally": equalise_locally(photo)}
figure, axes = plt.subplots(2, 3, figsize=(5.6, 3.2), height_ratios=(2, 1))
for (name, picture), (above, below) in zip(pictures.items(), axes.T, strict=True):
    above.imshow(picture, cmap="gray", vmin=0, vmax=255)
    above.set_title(name)
    above.axis("off")
    counted = exact_histogram(picture)
    below.stairs(counted.counts, counted.edges, fill=True, color="0.5")
    below.set(xlim=(0, 256), xticks=(0, 255), yticks=[])
