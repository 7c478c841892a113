"""The tables of keys on the pages of file formats, made from the schemas that read the files."""

import inspect
import re
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from site_text import write

from fitting.rig import Camera as RigCamera
from fitting.rig import Dark, Exposure, Flat, Geometry, Light, SphereGeometry
from jaxvision.scene_files import (
    camera_schema,
    light_schema,
    material_schema,
    spectrum_schema,
    surface_schema,
)
from jaxvision.scene_files.schema import RenderEntry, SceneEntry

SCENE = {  # the tables of a scene file, in the order of the page
    "[camera]": camera_schema.Camera,
    "[[surface]]": surface_schema.Surface,
    "[material.NAME]": material_schema.Material,
    "[[light]]": light_schema.Light,
    "[ambient]": light_schema.AmbientEntry,
    "[render]": RenderEntry,
    "Spectra": spectrum_schema.Spectrum,
    "Wavelengths": spectrum_schema.Wavelengths,
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
SAID = re.compile(r"^(\w+): (.*?)(?=\n\w+: |\Z)", re.DOTALL | re.MULTILINE)


def key_pages(folder):
    """Writes the tables that `write_a_scene_file.md` and `describe_a_rig.md` include."""
    write(folder / "_scene_keys.md", tables(SCENE))
    write(folder / "_rig_keys.md", tables(RIG))


def tables(parts):
    text = []
    for heading, hint in parts.items():
        text += [f"## {heading}" if heading.isalpha() else f"## `{heading}`", ""]
        for model in models_of(hint):
            text += table_of(model)
    return "\n".join(text)


def models_of(hint) -> list[type[BaseModel]]:
    """The kinds of table that may stand in one place."""
    if isinstance(hint, type) and issubclass(hint, BaseModel):
        return [hint]
    return [model for part in get_args(hint) for model in models_of(part)]


def table_of(model):
    about = (inspect.getdoc(model) or "").partition("\n\n")[0]
    said = described(model)
    kind = [
        f'### `{name} = "{words_of(field.annotation)[0]}"`\n'
        for name, field in model.model_fields.items()
        if name in ("kind", "shape", "family")
    ]
    lines = [
        *kind,
        " ".join(about.split()),
        "",
        "| key | meaning | default |",
        "| --- | --- | --- |",
    ]
    for name, field in model.model_fields.items():
        if name == "folder":
            continue
        default = "required" if field.is_required() else shown(field.default)
        words = words_of(field.annotation)
        meaning = " ".join(said.get(name, "").split()).replace("|", "\\|")
        if words and not all(word in meaning for word in words):
            meaning += f" One of {', '.join(map(repr, words))}.".replace("'", '"')
        lines.append(f"| `{name}` | {meaning} | {default} |")
    return [*lines, ""]


def described(model) -> dict[str, str]:
    """What the docstrings of a model and of what it extends say of each key."""
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
    """The words that a key takes."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if get_origin(hint) in (Annotated, Union) or "UnionType" in str(type(hint)):
        return tuple(word for part in get_args(hint) for word in words_of(part))
    return ()


assert {"camera", "surface", "material", "light", "ambient", "render"} <= set(
    SceneEntry.model_fields
)
