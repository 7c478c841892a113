#!/usr/bin/env bash
# The EMVA 1288 reference implementation, which says that it is of release 4.0, keeps the threshold
# of release 3.1, and its spectrogram of PRNU is not in the per cent of its axis. Needs Python 3.11
# and a package index. Versions: emva1288 1.0.2 (of 2023, the newest; it needs NumPy below 2), numpy
# 1.26.4, scipy 1.15.3, matplotlib 3.10.3.
#
# Expected: at the absolute sensitivity threshold the standard's SNR (21) is 1, whatever the camera:
# mu_e.min = sqrt(sigma_d^2 + sigma_q^2 / K^2 + 1/4) + 1/2, at least one electron (26, 27). And the
# spectrogram of pixels that differ by 1 % independently lies about the line PRNU = 1 % in the same
# axes, at every grey value.
# Happens: mu_e.min lacks the 1/4. Of a camera with .2 electrons of dark noise it is .7 electrons,
# where SNR is .81. The spectrogram is sqrt(power / mean): .2 at a mean of 400 DN and .5 at 2,500
# DN, both beside a line at 1; it is right at 10,000 DN alone.
# Source of what is right: EMVA Standard 1288, release 4.0 Linear (2021), equations 21, 26 and 27,
# and clause 8.6; Parseval's theorem.
# Exits with 0 while that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -q --disable-pip-version-check \
    emva1288==1.0.2 numpy==1.26.4 scipy==1.15.3 matplotlib==3.10.3
MPLBACKEND=Agg "$folder/env/bin/python" - <<'PYTHON'
import logging

import numpy as np
from emva1288.process import Data1288, Results1288
from emva1288.process.plotting import PlotHorizontalSpectrogramPRNU
from emva1288.process.routines import get_int_imgs
from matplotlib.figure import Figure

logging.disable(logging.CRITICAL)
rng = np.random.default_rng(0)
GAIN, DARK_NOISE, SHAPE = 20, 0.2, (100, 120)  # DN/e-, e-
gains = 1 + 0.01 * rng.standard_normal(SHAPE)


def results(grey):
    """Of a camera whose spatial level has this mean, DN."""

    def frames(electrons):
        mean = np.broadcast_to(electrons * gains, (2, *SHAPE))
        read = DARK_NOISE * rng.standard_normal(mean.shape)
        return np.clip(np.round(100 + GAIN * (rng.poisson(mean) + read)), 0, 65535).astype(np.int64)

    def temporal(electrons):
        sums = get_int_imgs(frames(electrons))
        return {**sums, "sum": sums["sum"].sum(), "pvar": sums["pvar"].sum()}

    lights = [0.0, *np.linspace(100, 4000, 24)]
    fixed = np.round(100 + grey * gains).astype(np.int64)  # of an average without temporal noise
    unlit = np.full(SHAPE, 100, np.int64)
    spatial = {0.0: get_int_imgs([unlit] * 16), 1000.0: get_int_imgs([fixed] * 16)}
    data = {"temporal": {1e7: {p: temporal(p) for p in lights}}, "spatial": {1e7: spatial}}
    result = Results1288(Data1288({**data, "height": SHAPE[0], "width": SHAPE[1]}).data)
    result.id = 1
    return result


result = results(400)
gain, noise, found = result.K, result.sigma_y_dark, result.u_e_min
print(f"K {gain:.2f} DN/e-, dark noise {noise / gain:.3f} e-: threshold {found:.3f} e-", end=", ")
snr = found / np.sqrt((noise / gain) ** 2 + found)
right = np.sqrt((noise / gain) ** 2 + 0.25) + 0.5
print(f"where SNR is {snr:.3f}; SNR is 1 at {right:.3f} e-")
as_known = abs(found - (noise / gain + 0.5)) < 1e-9 and 0.75 < snr < 0.87
for grey in (400, 2500, 10000):
    result = results(grey)
    plot = PlotHorizontalSpectrogramPRNU(Figure())
    plot.plot(result)
    curve, line = plot.ax.get_lines()[:2]
    level, prnu = np.sqrt(np.mean(curve.get_ydata()[1:] ** 2)), line.get_ydata()[0]
    print(f"mean {grey} DN: curve at {level:.3f}, line PRNU at {prnu:.3f} ({plot.ylabel!r})")
    as_known &= abs(level / (prnu / 100 * np.sqrt(grey)) - 1) < 0.1
raise SystemExit(not as_known)
PYTHON
