#!/usr/bin/env bash
# JAX 0.12 compiles every loop for one core of a processor, also a loop over large arrays.
# Needs Python 3.12 or newer (as python3, python3.12, python3.13 or of pyenv) and a package index.
# Versions: jax and jaxlib 0.11.2 and 0.12.0 (processor), numpy 2.4.6.
#
# Expected: each step of `jax.lax.map` over rows of 200,000 numbers uses all cores. XLA compiles a
# loop as one function for one core only if the loop touches less than 1,024 bytes.
# Happens: so it is in 0.11.2. In 0.12.0 every loop is marked as small, whatever its arrays. The
# results are the same. Rendering by paths took 1.6 times the processor time, and two to three times
# the time on two cores. A loop whose step sorts or calls a library is not marked. Without the pass,
# `xla_disable_hlo_passes`, the program is the earlier one.
# Source of what is right: XLA's xla/service/cpu/small_while_loop_hoisting_pass.cc, and its option
# xla_cpu_small_while_loop_byte_threshold.
# Exits with 0 while that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
recent=""
for python in python3 python3.12 python3.13 "$(pyenv root 2> /dev/null)"/versions/3.1[23]*/bin/python; do
  if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2> /dev/null; then
    recent=$python
  fi
done
[ -n "$recent" ] || { echo "no Python 3.12 or newer was found"; exit 1; }
cat > "$folder/mark.py" <<'PYTHON'
import sys

import jax
import jax.numpy as jnp

rows = jnp.ones((4, 200_000), jnp.float32)
lowered = jax.jit(lambda x: jax.lax.map(jnp.sin, x)).lower(rows)
options = {}, {"xla_disable_hlo_passes": "small-while-loop-hoisting"}
small = ["xla_cpu_small_call" in lowered.compile(compiler_options=o).as_text() for o in options]
print(f"jax {jax.__version__}: marked as small: {small[0]}, without the pass: {small[1]}")
raise SystemExit(small != [sys.argv[1] == "small", False])
PYTHON
for case in "0.11.2 large" "0.12.0 small"; do
  read -r version size <<< "$case"
  "$recent" -m venv "$folder/$version"
  "$folder/$version/bin/pip" install -q --disable-pip-version-check \
    "jax==$version" "jaxlib==$version" numpy==2.4.6
  JAX_PLATFORMS=cpu "$folder/$version/bin/python" "$folder/mark.py" "$size"
done
