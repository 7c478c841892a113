"""Pages that are generated before the site is built: the reference, the gallery and the notebooks.
This module also contains the hooks that change Sphinx's input."""

import ast
import importlib
import inspect
import pydoc
import re
import sys
from functools import cache
from pathlib import Path

from docutils import nodes
from file_keys import former_names, key_pages
from reference_pages import reference_pages
from site_text import escaped, plain_type, write
from sphinx.domains.python import PyXRefRole
from sphinx.util.docstrings import prepare_docstring

HERE = Path(__file__).parent
GALLERY = {  # the gallery's scripts by topic, in the order of the page
    "Light and surfaces": "ball lobes coats maps sky lamps daylight black_bodies separation "
    "gradient",
    "Shadows and global illumination": "soft_shadow cornell_box radiosity glass_and_mirror",
    "Cameras and lenses": "defocus apertures vignetting shift_variant diffraction aberrations"
    " rolling_shutter",
    "Sensors and files": "noise photon_transfer blooming demosaicing jpeg",
    "Points and filters": "tone equalisation smoothing orientation borders",
    "Compositing": "blue_screen hair_matte pyramid_blend",
    "Fitting and results": "own_fit lights stereo edge sensitivities results",
}


def notebook_pages(folder):
    """Copy the notebooks, which are outside the site's folder, into it."""
    folder.mkdir(exist_ok=True)
    for notebook in (HERE.parent / "notebooks").glob("*.ipynb"):
        write(folder / notebook.name, notebook.read_text())


def gallery_pages(folder):
    """Write a page for each script of the gallery, with the picture above the code, and a front
    page with all pictures.
    """
    order = [name for names in GALLERY.values() for name in names.split()]
    assert sorted(order) == sorted(script.stem for script in folder.glob("*.py"))
    text = f"# Gallery\n\n{len(order)} pictures, each with the script that drew it.\n\n"
    for topic, names in GALLERY.items():
        cards = [gallery_page(folder / f"{name}.py") for name in names.split()]
        text += (
            f"## {topic}\n\n::::{{grid}} 1 2 3 4\n:gutter: 3\n\n" + "\n".join(cards) + "::::\n\n"
        )
    listed = "\n".join(f"gallery/{name}" for name in order)
    text += f"```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    write(folder.parent / "gallery.md", text)


def gallery_page(script):
    """Write the page of one script, and return its card for the gallery's front page."""
    title, text = ast.get_docstring(ast.parse(script.read_text())).split("\n\n", 1)
    page = f"# {title}\n\n{text}\n\n"
    page += f"```{{image}} {script.stem}.png\n:alt: {title}\n:class: dark-light\n```\n\n"
    page += f"```{{literalinclude}} {script.name}\n:lines: {after_docstring(script)}-\n```\n"
    write(script.with_suffix(".md"), page)
    return (
        f":::{{grid-item-card}} {title}\n:link: gallery/{script.stem}\n:link-type: doc\n"
        f":img-top: gallery/{script.stem}.png\n:img-alt: {title}\n:::\n"
    )


def after_docstring(script):
    """Return the number of the first line of code after a script's docstring."""
    return ast.parse(script.read_text()).body[1].lineno


def write_types(app, what, name, thing, options, lines):
    """Write types such as `Float[Array, "*picture bands"]` readably in napoleon's text on
    attributes.
    """
    names = names_where(thing)
    for i, line in enumerate(lines):
        if head := re.match(r"\s*:vartype \w+: ", line):
            kind = plain_type(line[head.end() :].replace("\\*", "*"), names, app.entry)
            lines[i] = head[0] + kind.replace("*", "\\*")


def names_where(thing):
    """Return the names in the module that defines an object."""
    module = sys.modules.get(getattr(inspect.unwrap(thing), "__module__", None) or "")
    return vars(module) if module else {}


def skip_member(app, what, name, thing, skip, options):
    """Skip the fields of a named tuple, which the tuple's docstring explains."""
    return True if (inspect.getdoc(thing) or "").startswith("Alias for field") else None


def escape_docstring(app, what, name, thing, options, lines):
    if lines == prepare_docstring(type(thing).__doc__ or ""):
        lines.clear()  # a constant has only the words of its type
    if lines and lines[0].startswith(f"{name.rpartition('.')[2]} = "):  # what an alias stands for
        lines[0] = plain_type(lines[0])
    inside = False  # an example, whose text is code
    for i, line in enumerate(lines):
        inside = line.strip().startswith((">>>", "...")) or (inside and bool(line.strip()))
        if not inside:
            lines[i] = escaped(line)


def errors_of(code):
    """Return the label of a row in the table of errors, from the name in its first cell."""
    return "errors-of-" + re.match(r"[\w.]+", code)[0].replace(".", "-").replace("_", "-")


def rows_of_errors(entry_of):
    """Return {name of an entry: the label of its row in the table of errors}."""
    table = (HERE / "errors.md").read_text()
    names = re.findall(r"^\| `([\w.]+)", table, flags=re.MULTILINE)
    entries = {entry_of(f"jaxvision.{name}") or entry_of(name): errors_of(name) for name in names}
    return {entry: label for entry, label in entries.items() if entry}  # a method has none


def link_errors(app, what, name, thing, options, lines):
    """Link a function to its row in the table of errors."""
    if label := app.rows_of_errors.get(name):
        lines += ["", f"Rounding error: :ref:`the table's row <{label}>`.", ""]


def label_errors(app, doctree):
    """Add a label to the first row of each function in the table of errors."""
    if app.env.docname != "errors":
        return
    labels = app.env.get_domain("std").anonlabels
    for row in doctree.findall(nodes.row):
        codes = [*row[0].findall(nodes.literal)]
        label = errors_of(codes[0].astext()) if codes else None
        if label and label not in labels:
            row[0]["ids"].append(label)
            labels[label] = ("errors", label)


def short_types(app, domain, kind, content):
    """Replace the types that autodoc prints for arguments and results by the notation of the source
    code."""
    for name, types in app.env.current_document.autodoc_annotations.items():
        names = names_where(pydoc.locate(name)) if types else {}
        types.update({key: plain_type(text, names, app.entry) for key, text in types.items()})


def read_doctree(app, doctree):
    """Let names in tables break after a dot or an underscore, and join consecutive plots of curves
    into one grid.
    """
    for cell in doctree.findall(nodes.entry):
        for code in [*cell.findall(nodes.literal)]:
            for text in [*code.findall(nodes.Text)]:
                pieces = re.split(r"(?<=[._/])(?=\w)", text.astext())
                parts = [nodes.Text(pieces[0])]
                for piece in pieces[1:]:
                    parts += [nodes.raw("", "<wbr>", format="html"), nodes.Text(piece)]
                text.parent.replace(text, parts)
    for image in [*doctree.findall(nodes.image)]:
        if "curve" not in image["classes"] or "curves" in image.parent.get("classes", ()):
            continue
        around, at = image.parent, image.parent.index(image)
        row = nodes.container(classes=["curves"])
        while at < len(around) and is_curve(around[at]):
            around[at]["classes"].append("dark-light")  # their colours follow the page's
            row += around.pop(at)
        around.insert(at, row)


def is_curve(node):
    return isinstance(node, nodes.image) and "curve" in node["classes"]


class Entry(PyXRefRole):
    """{api}`name` links to the entry of a public name; a name without one fails the build."""

    def __init__(self):
        super().__init__(warn_dangling=True)

    def process_link(self, env, refnode, has_explicit_title, title, target):
        refnode["refdomain"], refnode["reftype"] = "py", "obj"
        return title, target


def find_entry(app, env, node, content):
    """Find the entry of an object that is named in another way: as another package exports it, or
    without the package.
    """
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    tries = [target, f"jaxvision.{target}", f"fitting.{target}"]
    tries += [f"{node['py:module']}.{target}"] if node.get("py:module") else []
    for name in tries:
        place = app.entry_of(name)
        if place:
            return app.builder.env.get_domain("py").resolve_xref(
                env, node["refdoc"], app.builder, "obj", place, node, content
            )
    return None


def finder(places):
    """Return a function from a name to the name of its entry, given {id of a value: entry}."""

    @cache
    def entry_of(name):
        module, _, last = name.rpartition(".")
        try:
            value = getattr(importlib.import_module(module), last)
        except (ImportError, AttributeError, ValueError):
            return None
        return places.get(id(value))

    return entry_of


def setup(app):
    notebook_pages(HERE / "notebooks")
    gallery_pages(HERE / "gallery")
    key_pages(HERE / "how-to")
    former_names(HERE / "how-to")
    pages = reference_pages(HERE / "reference")
    places = {id(value): name for page in pages.values() for name, value in page.items()}

    entry_of = finder(places)
    app.entry_of = entry_of
    app.entry = lambda value: places.get(id(value))
    app.add_role("api", Entry())
    app.connect("autodoc-process-docstring", escape_docstring, priority=100)
    app.rows_of_errors = rows_of_errors(entry_of)
    app.connect("autodoc-process-docstring", write_types, priority=900)
    app.connect("autodoc-process-docstring", link_errors, priority=950)
    app.connect("autodoc-skip-member", skip_member)
    app.connect("object-description-transform", short_types, priority=100)
    app.connect("doctree-read", label_errors, priority=400)
    app.connect("doctree-read", read_doctree)
    app.connect("missing-reference", find_entry)
    return {"parallel_read_safe": True}
