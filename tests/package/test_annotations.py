"""Tests annotated shapes and types with beartype in a separate process, where every public function
of numbers is traced with its example. In all tests the checks would cost a fifth of the time;
`pytest --jaxtyping-packages=jaxvision,fitting,beartype.beartype` enables them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
from functools import partial

from jaxtyping import install_import_hook

with install_import_hook(["jaxvision", "fitting"], "beartype.beartype"):
    import jax
    from examples import ROOMS, examples_of
    from public_names import traced
    from jaxvision import phong_lobe

    known = traced()
    wrong = []
    for room in ROOMS:
        for name, (arguments, options) in examples_of(room).items():
            try:
                jax.eval_shape(partial(known[name], **options), *arguments)
            except Exception as error:
                wrong.append(f"{name}: {type(error).__name__}: {error}")
    print(len(known), len(wrong), *wrong, sep="\\n")
    try:  # beneath what takes plain numbers too, which refuses first
        phong_lobe.__wrapped__(object(), 2.0)
    except Exception as error:
        print("refused:", type(error).__name__)
"""


@pytest.mark.slow  # CI runs it
def test_every_public_function_takes_and_returns_what_its_annotations_say():
    environment = {**os.environ, "JAX_ENABLE_X64": "1"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=Path(__file__).parents[1],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    count, wrong, *rest = run.stdout.splitlines()
    assert int(count) > 300
    assert wrong == "0", run.stdout
    assert rest == ["refused: TypeCheckError"]
