#!/usr/bin/env bash
# jax.random.choice draws entries whose probability is 0, from tables of some 1,000 entries on, such
# as the texels of a small environment map. Needs Python 3.11 and a package index. Versions: jax
# 0.10.2 (processor), numpy 2.4.
#
# Expected: an entry of probability 0 is never drawn, and the running sum of numbers that are not
# negative never falls, in whatever precision: each sum adds a number to the one before. NumPy's
# cumsum does not fall in float32.
# Happens: jnp.cumsum adds blocks in parallel, so neighbouring sums are rounded apart and some fall by
# a unit in the last place. choice searches these sums, and every second texel of this map is black:
# of 2 million draws some 6 are black texels in a map of 10,000, 60 in one of 100,000, 650 in one of
# a million. An estimator that divides by the probability of what it drew has an infinity there.
# Source of what is right: the law itself; the definition of a running sum.
# Exits with 0 while that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -q --disable-pip-version-check jax==0.10.2 'numpy>=2.4,<2.5'
"$folder/env/bin/python" - <<'PYTHON'
import jax
import jax.numpy as jnp
import numpy as np

black, falls = [], []
for size in (1_000, 10_000, 100_000, 1_000_000):
    radiance = np.random.default_rng(0).random(size) ** 8
    radiance[::2] = 0
    p = np.float32(radiance / radiance.sum())
    sums = np.asarray(jnp.cumsum(jnp.asarray(p)))
    drawn = np.asarray(jax.random.choice(jax.random.key(0), size, (2_000_000,), p=jnp.asarray(p)))
    falls.append(int((np.diff(sums) < 0).sum()))
    black.append(int((p[drawn] == 0).sum()))
    of_numpy = int((np.diff(np.cumsum(p)) < 0).sum())
    print(f"{size} texels: {falls[-1]} sums fall (NumPy {of_numpy}), {black[-1]} black texels drawn")
raise SystemExit(not (of_numpy == 0 and min(falls[1:]) > 0 and black[1] > 0 and black[3] > 100))
PYTHON
