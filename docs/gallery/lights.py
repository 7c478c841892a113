"""Lights from a mirror ball

Highlights of twelve lamps on a mirror ball, here added up in one picture, give the directions of
the lamps. The mask of the ball is off by .6 pixels, which rotates all directions in the same sense.
The crosses are the true directions, and the ellipses are 95 % regions of the estimates, seen from
the camera.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from fitting.lights import calibrate
from fitting.reflectance import Camera

rows, columns = np.mgrid[:161, :161] - 80.0
x, y = columns / 64, -rows / 64
z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
turns, tilt = 2.4 * np.arange(12), np.radians(np.linspace(15, 70, 12))
lamps = np.stack([np.sin(tilt) * np.cos(turns), np.sin(tilt) * np.sin(turns), np.cos(tilt)], -1)
mirrored = np.stack([2 * z * x, 2 * z * y, 2 * z * z - 1])  # directions that the ball shows
images = (z > 0) * (60 + 3500 * np.exp(600 * (np.tensordot(lamps, mirrored, 1) - 1)))
images = np.clip(images + np.random.default_rng(0).normal(0, 3, images.shape), 0, 4095).round()
found = calibrate(images, [np.hypot(columns - 0.6, rows) < 64], camera=Camera(bits=12).at("grey"))
figure, (ball, sky) = plt.subplots(1, 2, figsize=(6.6, 3.3))
ball.imshow(np.sqrt(images.max(axis=0)), cmap="gray")
ball.set(title="highlights", xticks=[], yticks=[])
for i, (across, up, _) in enumerate(found.places):
    squares, axes = np.linalg.eigh(found.covariance[i, :2, i, :2])
    size, angle = 2 * 2.448 * np.sqrt(squares), np.degrees(np.arctan2(*axes[::-1, 0]))
    sky.add_patch(Ellipse((across, up), *size, angle=angle, alpha=0.6))
sky.add_patch(plt.Circle((0, 0), 1, fill=False, color="0.5"))
sky.plot(lamps[:, 0], lamps[:, 1], "C1+")
sky.set(title="directions", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal")
