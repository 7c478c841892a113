"""Search for the worst float32 error of functions of several numbers by hill climbing in ULPs.

    python tests/stability/searched.py [--only WORD] [--record]

The search starts at the worst of 2e5 points, drawn as for the table, and moves them by random
numbers of units in the last place, from 1 to 2^20, as long as the error grows. The error at the
end is computed again with 60 digits. `--record` writes errors larger than those of the table to
`searched.json` and into the rows of `docs/errors.md`. A function takes a few seconds.
"""

import argparse
import json
import os
import re
import sys
import time
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")
sys.path.append(str(Path(__file__).parents[1]))

import jax
import numpy as np
import registry
from measure import errors_at, parts_of, seed_of
from oracle_numbers import DIGITS, LONG
from registry.entry import Columns, Range, Unit

RECORD = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).parents[2] / "docs" / "errors.md"
BATCH, FIRST, ROUNDS, KEPT = 4096, 48, 80, 32
FINE = "1e-15"  # relative step of the condition number at the end
FARTHEST = 20  # largest step, a power of 2 in ULPs


def recorded():
    """Return the recorded errors, {title of a row: {"worst", "at"}}."""
    return json.loads(RECORD.read_text()) if RECORD.exists() else {}


def is_searched(entry):
    """Return whether a function has several arguments of kinds that can be moved, and a fast
    oracle."""
    movable = all(isinstance(part, Range | Columns | Unit) for part in entry.domain)
    curve = len(entry.domain) == 1 and isinstance(entry.domain[0], Range)
    return movable and not curve and not entry.of_digits and "float32" in entry.precisions


def moved(rng, column, part):
    """Return a column of arguments, each moved with probability 1/2, within its domain."""
    size = np.exp2(rng.uniform(0, FARTHEST, column.shape))
    step = np.rint(size) * rng.choice([-1, 0, 0, 1], column.shape)
    bits = np.abs(column).view(np.int32) + step.astype(np.int64)
    bits = np.clip(bits, 0, np.float32(3e38).view(np.int32)).astype(np.int32)
    other = np.copysign(bits.view(np.float32), column)
    if isinstance(part, Unit):
        wide = other.astype(float)
        wide /= np.linalg.norm(wide, axis=-1, keepdims=True)
        outside = wide[:, 2:] < (part.least or (1e-3 if part.above else -2))
        return np.where(outside, column, wide).astype(np.float32)
    of = part.of if isinstance(part, Columns) else part
    sizes = np.clip(np.abs(other) if of.signed else other, of.low, of.high)
    return (np.copysign(sizes, other) if of.signed else sizes).astype(np.float32)


def climbed(entry):
    """Return {"worst", "at"} of each part of a function."""
    rng = np.random.default_rng(seed_of(entry) + 1)
    program = jax.jit(jax.vmap(entry.call))

    def errors(points):
        found = np.stack(errors_at(entry, parts_of(entry, program(*points)), points, LONG))
        return np.where(np.isfinite(found), found, 0)

    def drawn():
        return tuple(part.draw(rng, BATCH).astype(np.float32) for part in entry.domain)

    blocks = [(points, errors(points)) for points in (drawn() for _ in range(FIRST))]
    every = [np.concatenate(columns) for columns in zip(*(x for x, _ in blocks), strict=True)]
    sizes = np.concatenate([x for _, x in blocks], axis=1)
    result = []
    for p in range(len(entry.parts)):
        order = np.argsort(sizes[p])[-KEPT:]
        best, known = [column[order] for column in every], sizes[p][order]
        for _ in range(ROUNDS):
            parents = np.resize(np.arange(KEPT), BATCH)
            tried = tuple(
                moved(rng, column[parents], part)
                for column, part in zip(best, entry.domain, strict=True)
            )
            found = errors(tried)[p]
            for k in range(KEPT):  # each separately, so that they do not all end at one place
                own = np.flatnonzero(parents == k)
                top = own[np.argmax(found[own])]
                if found[top] > known[k]:
                    known[k] = found[top]
                    for column, new in zip(best, tried, strict=True):
                        column[k] = new[top]
        last = tuple(column[np.argsort(known)[-3:]] for column in best)
        got = parts_of(entry, program(*(np.resize(x, (BATCH, *x.shape[1:])) for x in last)))
        exact = errors_at(entry, [part[:3] for part in got], last, DIGITS, FINE)[p]
        k = int(np.argmax(exact))
        at = [np.asarray(column[k]).tolist() for column in last]
        result.append({"worst": float(exact[k]), "at": at})
    return result


def title_of(entry, part):
    return f"`{entry.title}` {part}".strip()


def marked(line, worst, bound):
    """Return a row of the page with the searched error, marked, and the bound."""
    from table import number

    cells = line.strip("| ").split(" | ")
    cells[1], cells[8] = f"{number(worst)} ‡", number(bound)
    return f"| {' | '.join(cells)} |"


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="")
    parser.add_argument("--record", action="store_true")
    asked = parser.parse_args(arguments)
    page, kept = PAGE.read_text(), recorded()
    for entry in registry.every_entry():
        if not is_searched(entry) or asked.only not in entry.title:
            continue
        begun = time.process_time()
        for part, found in zip(entry.parts, climbed(entry), strict=True):
            title = title_of(entry, part)
            row = re.search(rf"^\| {re.escape(title)}(?: †)? \| ([^|]*) \|.*$", page, re.MULTILINE)
            before = float(row[1].strip(" ‡")) if row else float("nan")
            grown = found["worst"] > 1.05 * before  # more than the page's two digits
            over = " OVER ITS BOUND" if found["worst"] > entry.bound else ""
            took = time.process_time() - begun
            told = f"{before:g} -> {found['worst']:.3g}, bound {entry.bound:g}{over}"
            print(f"{took:6.1f} s  {title}: {told}", flush=True)
            if grown and row:
                kept[title] = found
                page = page.replace(row[0], marked(row[0], found["worst"], entry.bound))
        if asked.record:
            RECORD.write_text(json.dumps(kept, indent=1) + "\n")
            PAGE.write_text(page)


if __name__ == "__main__":
    main()
