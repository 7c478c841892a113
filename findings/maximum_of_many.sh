#!/usr/bin/env bash
# A NaN among 4,096 numbers or more makes the maximum of JAX on a processor a wrong finite number.
# Needs Python 3.11 and a package index. Versions: jax 0.10.2 (processor), numpy 2.4.
#
# Expected: jnp.max is NaN if one number is NaN, as in NumPy and as it is for up to 4,095 numbers. If
# the NaN were ignored, the result would be the maximum of the other numbers.
# Happens: with 4,096 numbers the NaN is lost, and with it numbers before it: the maximum of 0, 1,
# ..., 4094 and a NaN at the end is -inf. With 100,000 numbers it is finite and 2 % too small.
# jnp.min and jnp.ptp do the same, with and without jit; jnp.sum is NaN, and jnp.nanmax is right. A
# picture of 64 x 64 pixels with one dead pixel is scaled by a wrong maximum without a warning.
# Source of what is right: the documentation of numpy.max, which jnp.max follows ("NaN values are
# propagated"), and StableHLO's `maximum`, by IEEE 754-2019.
# Exits with 0 while that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -q --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 'numpy>=2.4,<2.5'
JAX_PLATFORMS=cpu "$folder/env/bin/python" - <<'PYTHON'
import jax.numpy as jnp
import numpy as np

found = {}
for count in (4095, 4096, 100_000):
    numbers = np.arange(count, dtype=np.float32)
    numbers[-1] = np.nan
    found[count] = float(jnp.max(numbers))
    print(f"{count} numbers, the last NaN: {found[count]}; largest of the others: {count - 2}")
right = float(jnp.nanmax(numbers)), float(jnp.sum(numbers))
print(f"nanmax {right[0]}, sum {right[1]}")
known = np.isnan(found[4095]) and right[0] == 99_998 and np.isnan(right[1])
raise SystemExit(not (known and found[4096] == -np.inf and found[100_000] < 99_998))
PYTHON
