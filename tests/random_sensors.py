"""Random sensors and their light, as records of the library and as numbers for the oracle."""

import numpy as np

from jaxvision import scene as s

SHAPE = (16, 12)


def draw(seed, *, wells=True, further=False):
    """Return (sensor, numbers for the oracle, light in photons per pixel (h, w), rng)."""
    rng = np.random.default_rng(seed)

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    light = rng.uniform(0, 1, SHAPE) ** 3 * log(10, 3e4)
    fields = {"quantum_efficiency": log(0.1, 1), "gain": log(0.05, 2), "offset": 50.0}
    f = {"gain": fields["gain"], "offset": 50.0}

    def maybe(chance, name, low, high, record=None, key=None):
        if rng.random() < chance:
            value = log(low, high)
            fields[name] = value if record is None else record(value)
            f[key or name] = value

    if rng.random() < 0.8:
        fields["shot_noise"] = s.FastPoissonShotNoise()
        f["shot"] = True
    maybe(0.8, "read_noise", 0.01, 20)
    maybe(0.6, "dsnu", 0.001, 5)
    maybe(0.4, "column_dsnu", 0.001, 3)
    maybe(0.4, "row_noise", 0.001, 3)
    maybe(0.3, "row_dsnu", 0.001, 3)
    maybe(0.3, "reset_noise", 1e-18, 1e-15, lambda x: s.ResetNoise(x, 300.0))
    if "reset_noise" in f:
        f["reset_noise"] = (f["reset_noise"], 300.0)
    share = log(1e-5, 0.1)
    maybe(0.3, "telegraph_noise", 0.1, 20, lambda x: s.TelegraphNoise(share, x), "telegraph")
    maybe(0.3, "banding", 0.001, 3, lambda x: s.Banding(x, 7.0))
    maybe(0.5, "prnu", 1e-6, 0.02)
    maybe(0.3, "conversion_prnu", 1e-6, 0.02)
    maybe(0.3, "column_prnu", 1e-6, 0.02)
    maybe(0.4, "crosstalk", 1e-6, 0.05)
    maybe(0.3, "smear", 1e-8, 1e-3)
    maybe(0.5, "dark_current", 1e-4, 50, key="dark")
    maybe(0.2, "hot_pixels", 1e-2, 1e3, lambda x: s.HotPixels(share, x), "hot")
    if wells and rng.random() < 0.5:
        maybe(1.0, "full_well", 2e3, 1e6, key="full_well")
        if rng.random() < 0.5:
            fields["blooming"] = 0.5
    else:
        maybe(0.3, "charge_transfer", 1e-8, 1e-4, s.ChargeTransfer)
    if rng.random() < 0.7:
        fields["bits"] = 16
    if rng.random() < 0.2 and "read_noise" in f:
        rms = f["read_noise"]
        fields["read_noise"] = s.HeavyTailedReadNoise(rms, 3 * rms, 0.05)
        f["read_noise"] = (rms, 3 * rms, 0.05)
    if further:
        own = np.random.default_rng([seed, 7])
        found = _further(own, light, fields, f)
        fields |= found
    return s.Sensor(**fields), f, light, rng


def _further(rng, light, fields, f):
    """Return fields in addition to those of `draw`, and add them to the oracle's numbers."""

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    found = {}
    for name in ("column_noise", "frame_noise"):
        if rng.random() < 0.5:
            found[name] = f[name] = log(1e-3, 3)
    if rng.random() < 0.5:
        found["light_offset"] = log(1e-2, 300)
        f["beside"] = found["light_offset"] * fields["quantum_efficiency"]
    if rng.random() < 0.5:
        kernel = rng.dirichlet(np.ones(8)) * log(1e-6, 0.1)
        kernel = np.insert(kernel, 4, 1 - kernel.sum()).reshape(3, 3)
        found["mixing"], f["mixing"] = s.Mixing(kernel), kernel
    if rng.random() < 0.6:
        top = float(light.max()) * log(0.3, 3)
        first, second = (float(x) for x in rng.normal(0, log(1e-4, 0.05), 2))
        found["nonlinearity"] = s.Compression(first, second, electrons=top)
        f["nonlinearity"] = first, second, top
    if rng.random() < 0.5:
        pattern = ((0, 1), (2, 3)) if rng.random() < 0.5 else ((0, 1),)
        count, stretched = len(pattern) * 2, bool(rng.random() < 0.5)
        chosen = {
            "offset": rng.normal(0, log(1e-3, 3), count),
            "gain": 1 + rng.uniform(-1, 1, count) * log(1e-5, 0.1),
        }
        for name in ("read_noise", "prnu"):
            if name in fields and rng.random() < 0.5:
                chosen[name] = rng.uniform(0.5, 2, count)
        if rng.random() < 0.5:
            chosen["quantum_efficiency"] = rng.uniform(0.3, 1.2, count)
        found["taps"] = s.Taps(pattern, **chosen, stretched=stretched)
        rows, columns = (np.arange(n) for n in SHAPE)
        height, width = len(pattern), 2
        if stretched:
            index = (rows * height // SHAPE[0])[:, None] * width + columns * width // SHAPE[1]
        else:
            index = (rows % height)[:, None] * width + columns % width
        f["taps"] = {name: values[index] for name, values in chosen.items()}
    return found


# Names of the fields of `Sensor` among the oracle's numbers.
KEYS = {
    "dark_current": "dark",
    "hot_pixels": "hot",
    "telegraph_noise": "telegraph",
    "shot_noise": "shot",
    "light_offset": "beside",
}


def without(f, gone):
    """Return the oracle's numbers without the dropped effects."""
    left = dict(f)
    for name in gone:
        field = name.removeprefix("sensor.")
        left.pop(KEYS.get(field, field), None)
    return left
