#!/usr/bin/env bash
# jax.jit turns (1 + x) - 1 into x: compensated formulas, which need what the sum lost, break.
# Needs Python 3.11 and a package index. Versions: jax 0.10.2 (processor), numpy 2.4.
#
# Expected: XLA's fast arithmetic is off by default on processors, so that float operations are not
# rearranged, compiled and eager code agree, and Kahan's log(u) x / (u - 1) with u = 1 + x is log1p.
# Happens: compiled, (1 + x) - 1 is x for every x, even 1e-20; eager it is 0 there, as IEEE 754
# says. Kahan's log1p is right when eager and off by 5 % at 1e-6 when compiled.
# Source of what is right: IEEE 754-2019, section 10.4 (value-changing transformations only by
# request); Goldberg, "What Every Computer Scientist Should Know About Floating-Point Arithmetic"
# (ACM Computing Surveys 1991), theorem 4, for the formula.
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


def back(x):
    return (1 + x) - 1


def kahan(x):
    u = 1 + x
    return jnp.where(u == 1, x, jnp.log(u) * x / jnp.where(u == 1, 1, u - 1))


x = jnp.asarray([1e-20, 1e-10, 1.2e-7], jnp.float32)
print("(1 + x) - 1, eager:", back(x), "compiled:", jax.jit(back)(x))
y = jnp.asarray([1e-6, 3e-6, 1e-5], jnp.float32)
truth = np.log1p(np.asarray(y, float))
error = [float(np.abs(np.asarray(f(y)) / truth - 1).max()) for f in (kahan, jax.jit(kahan))]
print("relative error of Kahan's log1p at 1e-6 to 1e-5, eager: %.1g, compiled: %.1g" % tuple(error))
rearranged = bool((jax.jit(back)(x) == x).all()) and float(back(x)[0]) == 0
raise SystemExit(not (rearranged and error[0] < 1e-6 < error[1]))
PYTHON
