"""Run blocks of code on a page, and compare their output with the comments beside them."""

import re
import subprocess
import sys


def blocks(page, language):
    """Return the fenced blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)


def promises(block):
    """Return [(number, tolerance)] stated in the comments beside a block's `print`, in order."""
    found = []
    for line in re.findall(r"^.*\bprint\(.*$", block, flags=re.MULTILINE):
        comment = re.search(
            r"#\s*([-+\d.]+(?:e[-+]?\d+)?)(?: within ([\d.]+) %)?(?=\s|$|[:,;])", line
        )
        if not comment:
            found.append(None)
            continue
        value, percent = float(comment[1]), comment[2]
        digits = len(comment[1].partition(".")[2])
        found.append((value, abs(value) * float(percent) / 100 if percent else 0.5 * 10**-digits))
    return found


PROGRAM = """
import jax
space = {}
for i, block in enumerate(BLOCKS):
    if APART:
        space = {}
        jax.config.update("jax_enable_x64", False)  # as a user starts
    exec(compile(block, f"block {i}", "exec"), space)
    print("<end>", flush=True)
"""


def printed(python, folder, *, apart):
    """Return what each block prints, run in one process, separately or each continuing the previous
    one."""
    program = PROGRAM.replace("BLOCKS", repr(python)).replace("APART", repr(apart))
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split("<end>\n")[:-1]


def kept_promises(python, said):
    """Check that printed numbers agree with the comments, and return how many there are."""
    kept = 0
    for block, text in zip(python, said, strict=True):
        for promise, line in zip(promises(block), text.splitlines(), strict=False):
            if promise:
                assert abs(float(line.split()[0]) - promise[0]) <= promise[1], (block, line)
                kept += 1
    return kept


def run(python, folder, *, apart):
    """Run blocks, check their printed numbers, and return how many there are."""
    return kept_promises(python, printed(python, folder, apart=apart))


def shown(page):
    """Return the output that a page shows below each block of Python."""
    below = r"^```python\n.*?^```\n(?:\n```text\n(.*?)^```)?"
    return re.findall(below, page, flags=re.MULTILINE | re.DOTALL)
