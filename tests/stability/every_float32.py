"""Measure every float32 of a curve's domain, or one in `--stride`, against the oracle in float64.
The worst is checked with 60 digits.

    python tests/stability/every_float32.py [--only WORD] [--stride 1] [--kept FOLDER] [--record]

There are up to 2e9 numbers in a function, and 17e9 in all. A run that was killed continues.
`--record` writes the results to `every_float32.json`, from which the table of errors is made."""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

os.environ.setdefault("JAX_ENABLE_X64", "1")
sys.path.append(str(Path(__file__).parents[1]))

import jax
import registry
from measure import errors_at, parts_of
from oracle_numbers import DIGITS, DOUBLE

BLOCK = 2**21
RECORD = Path(__file__).with_suffix(".json")


KEPT = ("numbers", "worst", "at", "mean", "not_finite")


def recorded():
    """Return {title: what `swept` found at every number}."""
    return json.loads(RECORD.read_text()) if RECORD.exists() else {}


def stretches(entry):
    """Return (first, last, sign) of the bits of the magnitudes in a domain."""
    low, high = entry.domain[0].low, entry.domain[0].high
    bits = [int(np.float32(abs(end)).view(np.int32)) for end in (low, high)]
    if low >= 0:
        return [(bits[0], bits[1], 1)]
    return [(0, bits[0], -1), (0, bits[1], 1)]


def numbers(entry, stride):
    """Yield the floats of a domain, block by block."""
    for first, last, sign in stretches(entry):
        for start in range(first, last + 1, BLOCK * stride):
            bits = np.arange(start, min(start + BLOCK * stride, last + 1), stride, np.int64)
            yield sign * bits.astype(np.int32).view(np.float32)


def swept(entry, *, stride=1, kept=None, say=lambda *_: None):
    """Return {"worst", "at", "mean", "numbers", "not_finite"} of a curve."""
    program = jax.jit(jax.vmap(entry.call))
    state = {"block": 0, "worst": 0.0, "at": 0.0, "sum": 0.0, "numbers": 0, "not_finite": 0}
    if kept is not None and kept.exists():
        state = json.loads(kept.read_text())
    for number, x in enumerate(numbers(entry, stride)):
        if number < state["block"]:
            continue
        got = parts_of(entry, program(np.resize(x, BLOCK)))[0][: len(x)]
        errors = errors_at(entry, [got], (x,), DOUBLE)[0]
        state["not_finite"] += int((~np.isfinite(errors)).sum())
        errors = np.where(np.isfinite(errors), errors, 0)
        k = int(errors.argmax())
        checked = float(errors_at(entry, [got[k : k + 1]], (x[k : k + 1],), DIGITS)[0][0])
        if checked > state["worst"]:
            state["worst"], state["at"] = checked, float(x[k])
        state["sum"] += float(errors.sum())
        state["numbers"] += len(x)
        state["block"] = number + 1
        if kept is not None:
            part = kept.with_suffix(".part")
            part.write_text(json.dumps(state))
            part.replace(kept)
        say(state)
    return {**state, "mean": state["sum"] / max(state["numbers"], 1)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="")
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--record", action="store_true")
    asked = parser.parse_args()
    for entry in registry.every_entry():
        if not entry.is_curve or asked.only not in entry.title:
            continue
        kept = None
        if asked.kept is not None:
            asked.kept.mkdir(parents=True, exist_ok=True)
            kept = asked.kept / f"{entry.title.replace(' ', '_')}.{asked.stride}.json"
        begun = time.process_time()
        found = swept(entry, stride=asked.stride, kept=kept)
        print(
            f"{entry.title}: {found['worst']:.2f} ULP at {found['at']:.9g}, mean "
            f"{found['mean']:.3f}, {found['numbers']} numbers, {found['not_finite']} not finite, "
            f"{time.process_time() - begun:.0f} s",
            flush=True,
        )
        if asked.record and asked.stride == 1:
            known = recorded() | {entry.title: {n: found[n] for n in KEPT}}
            RECORD.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n")


if __name__ == "__main__":
    main()
