"""Text of the site: readable types, and docstrings as reStructuredText."""

import re
import sys

# Text that surrounds the names of types when they are printed.
OF_TYPES = re.compile(
    r"<class '|'>|~?\b(?:jaxtyping|typing|jaxlib\._jax|jaxvision\.core\._vector)\."
)
NAMED = re.compile(r"(?<![\w.])(~?)((?:jaxvision|fitting)(?:\.\w+)*)\.([A-Z]\w*)(?![\w.])")


def write(file, text):
    """Write a file only if its content changed, so that a second build reads nothing again."""
    if not file.exists() or file.read_text() != text:
        file.write_text(text)


def escaped(text):
    """Convert plain text with code in backticks, as in docstrings, to reStructuredText."""
    bullet, text = re.match(r"(\s*(?:\* )?)(.*)", text, flags=re.DOTALL).groups()
    parts = re.split(r"(`[^`]*`)", text)
    plain = [re.sub(r"([*|\\]|_(?!\w))", r"\\\1", part) for part in parts[::2]]
    plain[1:] = [re.sub(r"^(?=[\w^(])", r"\\", part) for part in plain[1:]]  # ends the code before
    return bullet + "".join(p + q for p, q in zip(plain, [*parts[1::2], ""], strict=True))


def explained(docstring):
    """Convert a module's docstring to reStructuredText: indented formulas and tables stay
    unchanged, and a heading such as "Source:" is put before its text.
    """
    text = []
    for block in re.split(r"\n\s*\n", docstring):
        lines = block.splitlines()
        if all(line.startswith("    ") for line in lines):
            text += [".. code-block:: text", "", *(line.rstrip() for line in lines), ""]
        elif len(lines) > 1 and all(re.match(r"\S+ {2,}\S", line) for line in lines):  # a table
            text += [".. code-block:: text", "", *(f"    {line.rstrip()}" for line in lines), ""]
        elif len(lines) > 1 and all(line.startswith("    ") for line in lines[1:]):
            if not lines[0].endswith(":"):
                text += [escaped(lines[0]), ""]
                text += [".. code-block:: text", "", *lines[1:], ""]
            else:
                text += [escaped(" ".join(line.strip() for line in lines)), ""]
        elif any(re.match(r"[*-] ", line) for line in lines):
            text += [*map(escaped, lines), ""]
        else:
            text += [escaped(" ".join(lines)), ""]
    return text


def plain_type(text, names=None, entry_of=lambda value: None):
    """Return a type as source code writes it, such as `Float[Array, "levels"]` or `float`.

    A type that has an entry in the reference is written by its name, and any other alias by its
    definition.

    Args:
        text: as the type prints itself.
        names: what the module that uses the type knows, by name.
        entry_of: the name of a thing's entry, or None.
    """

    def meant(found):
        short, module, name = found.groups()
        value = (names or {}).get(name) if module in ("jaxvision", "fitting") else None
        value = getattr(sys.modules.get(module), name, None) if value is None else value
        if value is None:
            return found[0]
        if entry := entry_of(value):
            return short + entry
        alias = re.fullmatch(r"\w+ = (.*)", value.__doc__ or "")
        return plain_type(alias[1], names, entry_of) if alias else found[0]

    text = NAMED.sub(meant, OF_TYPES.sub("", without_checks(text)))
    return re.sub(r"'([^']*)'", r'"\1"', text)


def without_checks(text):
    """Replace `Annotated[X, ...]` by X, anywhere in a type."""
    while found := re.search(r"(?:~?typing\.|~)?\bAnnotated\[", text):
        depth, parts = 0, [found.end()]
        for at, letter in enumerate(text[found.end() :], found.end()):
            depth += (letter in "[(") - (letter in "])")
            if depth < 0:
                break
            if letter == "," and not depth:
                parts.append(at)
        first = text[parts[0] : parts[1] if len(parts) > 1 else at]
        text = text[: found.start()] + first + text[at + 1 :]
    return text
