"""The tables of keys for the pages on file formats, generated from the schemas that read the files,
and the table of former names.

    python docs/file_keys.py

writes the tables of keys without building the site.
"""

import inspect
import re
from dataclasses import MISSING
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from site_text import write

from fitting.rig import Camera as RigCamera
from fitting.rig import Dark, Exposure, Flat, Geometry, Light, SphereGeometry
from jaxvision.core._moved import MOVED, RENAMED
from jaxvision.core._types import members_of
from jaxvision.files.records import Key, keys_of
from jaxvision.files.scenes import tables as scene_tables
from jaxvision.files.scenes.bands import Tabulated
from jaxvision.files.scenes.maps import make_map
from jaxvision.files.scenes.schema import Grid, RenderEntry, SceneEntry
from jaxvision.scene import AmbientLight


def kinds_of(word, tables, beside=None):
    """The tables that may occur at one place in a file: the key that selects the type of table, the
    function that makes its record, and its keys.
    """
    more = {} if beside is None else keys_of(beside)
    return [
        (f'{word} = "{name}"', make, {word: Key(str, MISSING, f'"{name}".')} | more | keys)
        for name, (make, keys) in tables.items()
    ]


def plain(makers):
    return {name: (make, keys_of(make)) for name, make in makers.items()}


def registered(tables):
    return {name: (table.make, scene_tables.keys_of_kind(table)) for name, table in tables.items()}


SCENE = {  # the tables of a scene file, in the order of the page
    "[camera]": kinds_of("kind", plain(scene_tables.VIEWS), scene_tables.camera_keys),
    "[[surface]]": kinds_of("shape", plain(scene_tables.SHAPES), scene_tables.surface_keys),
    "[material.NAME]": kinds_of("family", registered(scene_tables.material_tables())),
    "[[light]]": kinds_of("kind", registered(scene_tables.light_tables()), scene_tables.light_keys),
    "[ambient]": [("", AmbientLight, keys_of(AmbientLight))],
    "[render]": RenderEntry,
    "Spectra": [("", Tabulated, keys_of(Tabulated))],
    "Maps": [("", make_map, keys_of(make_map))],
    "Wavelengths": Grid,
}
RIG = {
    "[camera]": RigCamera,
    "[[flat]]": Flat,
    "[[dark]]": Dark,
    "[[exposure]]": Exposure,
    "[[light]]": Light,
    "[geometry]": Geometry,
    "geometry.sphere": SphereGeometry,
}
SHAPE = re.compile(r"^(?:(?:or )?(?:neutral )?\([^)]*\),? )+(?!pixels)")  # before the unit
STATIC = re.compile(r"[;.] [Ss]tatic(?=\.$)")  # concerns Python alone
SAID = re.compile(r"^(\w+): (.*?)(?=\n\w+: |\Z)", re.DOTALL | re.MULTILINE)


def key_pages(folder):
    """Write the tables of keys that `write_a_scene_file.md` and `describe_a_rig.md` include."""
    write(folder / "_scene_keys.md", tables(SCENE))
    write(folder / "_rig_keys.md", tables(RIG))


def former_names(folder):
    """Write the table of former names that the changelog's page includes."""
    functions = {old: f"{old.rpartition('.')[0]}.{new}" for old, new in RENAMED.items()}
    rows = [
        f"| `{old}` | `{new}` |"
        for old, new in sorted((MOVED | functions).items())
        if "._" not in old
    ]
    text = "\n".join(["| former name | name |", "| --- | --- |", *rows, ""])
    write(folder / "_former_names.md", text)


def tables(parts):
    text = []
    for heading, hint in parts.items():
        text += [f"## {heading}" if heading.isalpha() else f"## `{heading}`", ""]
        for heading, about, keys in hint if isinstance(hint, list) else map(read, models_of(hint)):
            text += table_of(heading, about, keys)
    return "\n".join(text)


def models_of(hint) -> list[type[BaseModel]]:
    """Return the types of table that may occur at one place in a file."""
    if isinstance(hint, type) and issubclass(hint, BaseModel):
        return [hint]
    return [model for part in get_args(hint) for model in models_of(part)]


def read(model: type[BaseModel]):
    """Return the keys of a table that a pydantic model declares, in the form used for the tables of
    records."""
    said = described(model)
    keys = {
        name: Key(
            field.annotation,
            MISSING if field.is_required() else field.default,
            said.get(name, ""),
        )
        for name, field in model.model_fields.items()
        if name != "folder"
    }
    return "", model, keys


def table_of(heading, make, keys):
    about = (inspect.getdoc(make) or "").partition("\n\n")[0]
    lines = [
        *([f"### `{heading}`\n"] if heading else []),
        " ".join(about.split()),
        "",
        "| key | meaning | default |",
        "| --- | --- | --- |",
    ]
    for name, key in keys.items():
        default = "required" if key.default is MISSING else shown(key.default)
        if key.default is MISSING and "by default" in key.about:
            default = "by integrator"
        words = words_of(key.hint)
        meaning = SHAPE.sub("", STATIC.sub("", " ".join(key.about.split()))).replace("|", "\\|")
        if words and not all(word in meaning for word in words):
            meaning += f" One of {', '.join(map(repr, words))}.".replace("'", '"')
        lines.append(f"| `{name}` | {meaning} | {default} |")
    return [*lines, ""]


def described(model) -> dict[str, str]:
    """Return the description of each key, from the docstrings of a model and of its base
    classes.
    """
    found: dict[str, str] = {}
    for one in reversed(model.__mro__):
        doc = inspect.cleandoc(one.__dict__.get("__doc__") or "")
        attributes = doc.partition("Attributes:\n")[2].partition("\n\n")[0]
        lines = [line.removeprefix("    ") for line in attributes.splitlines()]
        found |= dict(SAID.findall("\n".join(lines)))
    return found


def shown(default: Any) -> str:
    if default is None:
        return "absent"
    if isinstance(default, str):
        return f'"{default}"' if default else "none"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple):
        return f"[{', '.join(f'{part:g}' for part in default)}]" if default else "none"
    return f"{default:g}"


def words_of(hint) -> tuple[str, ...]:
    """Return the words that a key accepts as values."""
    if get_origin(hint) is Annotated:
        return words_of(get_args(hint)[0])
    literals = [one for one in members_of(hint) if get_origin(one) is Literal]
    return tuple(word for one in literals for word in get_args(one))


assert {"camera", "surface", "material", "light", "ambient", "render"} <= set(
    SceneEntry.model_fields
)


if __name__ == "__main__":
    key_pages(Path(__file__).parent / "how-to")
