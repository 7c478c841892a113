"""Mean and variance of every pixel of a sensor in plain NumPy, one effect after the other.

`law` takes a dictionary of parameters, light in electrons per pixel, and whether the pixel has a
trap, is hot or dead. Nothing of the library is used. A full well is applied to the exact
distribution: Poisson counts at Gauss-Hermite nodes of the sensitivity."""

import numpy as np
from scipy import stats

K_B, Q = 1.380649e-23, 1.602176634e-19


def tap(f, name):
    """Return the factor of each pixel's tap on a parameter, or its addition to the offset."""
    return f.get("taps", {}).get(name, 0.0 if name == "offset" else 1.0)


def shared(picture, weights):
    """Return a picture whose pixels share their charge by `weights`, with mirrored borders."""
    rows, columns = (n // 2 for n in weights.shape)
    wide = np.pad(picture, ((rows, rows), (columns, columns)), mode="symmetric")
    h, w = picture.shape
    found = np.zeros_like(picture)
    for i in range(weights.shape[0]):
        for j in range(weights.shape[1]):
            y, x = 2 * rows - i, 2 * columns - j
            found += weights[i, j] * wide[y : y + h, x : x + w]
    return found


def acted(f, mean, variance):
    """Return mean and variance after mixing and compression, to second order in the noise."""
    if "mixing" in f:
        mean, variance = shared(mean, f["mixing"]), shared(variance, f["mixing"] ** 2)
    if "nonlinearity" in f:
        c, d, top = f["nonlinearity"]
        u = np.clip(mean / top, 0, 1)
        slope = 1 - 2 * c * u - 3 * d * u**2
        bend = np.where(mean < top, -(2 * c + 6 * d * u) / top, 0)
        bent = top * u * (1 - c * u - d * u**2) + (mean - top * u) * slope
        mean, variance = bent + bend * variance / 2, slope**2 * variance
    return mean, variance


def read_variance(f):
    """Return the variance after the conversion, in electrons^2, that every pixel has."""
    lines = "dsnu", "column_dsnu", "row_dsnu", "row_noise", "column_noise", "frame_noise"
    total = sum(f.get(n, 0.0) ** 2 for n in lines)
    total += f.get("banding", 0.0) ** 2 / 2
    if "reset_noise" in f:
        capacitance, kelvin = f["reset_noise"]
        total += K_B * kelvin * capacitance / Q**2
    match f.get("read_noise"):
        case (rms, tail, share):
            total += tap(f, "read_noise") ** 2 * ((1 - share) * rms**2 + share * tail**2)
        case None:
            pass
        case rms:
            total += tap(f, "read_noise") ** 2 * rms**2
    return total


def drift(f, light):
    """Return the expected electrons after smear and crosstalk."""
    column = light.sum(0, keepdims=True)
    light = light + f.get("smear", 0.0) * (column - light)
    wide = np.pad(light, 1, mode="edge")
    around = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    c = f.get("crosstalk", 0.0)
    return (1 - 4 * c) * light + c * around


def transfer_matrix(size, inefficiency, trail):
    """Return the shares (read in row, from row): binomial probabilities of being left behind."""
    shares = np.zeros((size, size))
    for i in range(size):
        lag = stats.nbinom.pmf(np.arange(trail), i + 1, 1 - inefficiency)
        for k in range(min(trail, size - i)):
            shares[i + k, i] = lag[k]
        if i + trail < size:
            shares[i + trail, i] = 1 - lag.sum()
    return shares


def moved(f, mean, pattern, counted):
    """Return mean, variance of the pattern and counted variance after charge transfer along the
    columns."""
    if "charge_transfer" not in f:
        return mean, pattern, counted
    rows = transfer_matrix(mean.shape[0], f["charge_transfer"], 8)
    return rows @ mean, rows**2 @ pattern, rows @ mean if f.get("shot") else counted


def charge(f, light, hot):
    """Return mean and variance of the converted charge."""
    p, well = f.get("prnu", 0.0) * tap(f, "prnu"), f.get("full_well", np.inf)
    excess = f.get("hot", 0.0) if hot else 0.0  # its standard deviation equals its mean
    if np.isfinite(well):
        return clipped(light, f, hot)
    mean = light + f.get("dark", 0.0) + excess
    mean, pattern, counted = moved(f, mean, (p * light) ** 2 + excess**2, mean)
    return mean, pattern + (counted if f.get("shot") else 0.0)


def clipped(light, f, hot):
    """Return moments of min(N, w): E N 1[N < w] and so on for Poisson counts, with sensitivities
    and the excess of a hot pixel by quadrature."""
    well = f["full_well"]
    g, weight = np.polynomial.hermite_e.hermegauss(31 if not hot else 7)
    weight = weight / weight.sum()
    p = f.get("prnu", 0.0) * tap(f, "prnu")
    m = np.maximum(1 + p * g[:, None, None], 0) * light[None] + f.get("dark", 0.0)
    if hot and "hot" in f:
        x, share = np.polynomial.laguerre.laggauss(24)
        m = (m[:, None] + f["hot"] * x[None, :, None, None]).reshape(-1, *light.shape)
        weight = np.outer(weight, share).ravel()
    if not f.get("shot"):
        n = np.minimum(m, well)
        first, second = n, n**2
    else:
        below = np.ceil(well) - 1
        upper = stats.poisson.sf(below, m)
        first = m * stats.poisson.cdf(below - 1, m) + well * upper
        second = m**2 * stats.poisson.cdf(below - 2, m) + m * stats.poisson.cdf(below - 1, m)
        second = second + well**2 * upper
    w = weight[:, None, None]
    mean = (w * first).sum(0)
    return mean, np.maximum((w * second).sum(0) - mean**2, 0)


def law(f, light, *, trapped=False, hot=False, dead=False):
    """Return (mean, standard deviation) in DN of each pixel before rounding.

    f: prnu, conversion_prnu, column_prnu, crosstalk, smear, charge_transfer (inefficiency), dark,
    hot (electrons), shot (bool), full_well, gain, offset and the sources of `read_variance`; beside
    (electrons), mixing (kernel), nonlinearity (first, second, electrons) and taps (maps); light:
    (h, w) expected photoelectrons."""
    light = (light + f.get("beside", 0.0)) * tap(f, "quantum_efficiency")
    light = drift(f, light) * (0.0 if dead else 1.0)
    mean, variance = acted(f, *charge(f, light, hot))
    c, q, k = f.get("conversion_prnu", 0.0), f.get("column_prnu", 0.0), f.get("gain", 1.0)
    variance = variance * (1 + c**2) + c**2 * mean**2 + read_variance(f)
    variance = variance + (f.get("telegraph", 0.0) ** 2 / 2 if trapped else 0.0)
    variance = variance * (1 + q**2) + q**2 * mean**2
    k, offset = k * tap(f, "gain"), f.get("offset", 0.0) + tap(f, "offset")
    return k * mean + offset, k * np.sqrt(variance)


def distance(one, other):
    """Return the largest sqrt((difference of means)^2 + (difference of standard deviations)^2)."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]).max())


def check_moments(sample, mean, variance, fourth):
    """Check mean and variance of a sample. With the fourth central moment `fourth`, the standard
    error of a variance is sqrt((m4 - v^2) / n)."""
    sample = np.asarray(sample, float).ravel()
    assert abs(sample.mean() - mean) < 5 * np.sqrt(variance / sample.size) + 1e-12
    assert abs(sample.var() - variance) < 5 * np.sqrt((fourth - variance**2) / sample.size) + 1e-12
