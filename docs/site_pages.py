"""Pages that are made from the packages: the reference, by module, and the gallery.

Every public name has one entry, under the shortest name by which it is imported. Other names of the
same thing, and names without their package, lead to that entry.
"""

import ast
import importlib
import inspect
import pkgutil
import re
from collections import defaultdict
from pathlib import Path

from docutils import nodes
from sphinx.domains.python import PyXRefRole
from sphinx.util.docstrings import prepare_docstring

import fitting
import jaxvision

HERE = Path(__file__).parent
ROOTS = jaxvision, fitting
BASICS = "arrays"  # the page of what is defined at the root of `jaxvision`: types, vectors, norms
GROUPS = {  # of the reference's front page; what no group names is machinery
    "Scenes and surfaces": "scene geometry brdf lifted_scene rendering transport shading shadows "
    "hemisphere hemisphere_integral effects scene_checks",
    "Light": "lights spectra colour_data",
    "Cameras and sensors": "shot cameras optics sensor colour_filters development",
    "Pictures": "filters padding point_ops colour_spaces histogram compositing matting plots",
    "Files and commands": "io image_settings raw_files scene_files scenes camera_files "
    "material_files mesh_files gltf_files measured_files render_command",
    "Accuracy": "accuracy",
    "Fitting": "fitting",
    "Machinery": "",
}
GALLERY = {  # the gallery's scripts by topic, in the order of the page
    "Light and surfaces": "ball lobes sky black_bodies separation gradient",
    "Shadows and global illumination": "soft_shadow cornell_box radiosity glass_and_mirror",
    "Cameras and lenses": "defocus apertures vignetting shift_variant diffraction rolling_shutter",
    "Sensors and files": "noise photon_transfer blooming demosaicing jpeg",
    "Points and filters": "tone equalisation smoothing orientation borders",
    "Compositing": "blue_screen pyramid_blend",
    "Fitting and results": "own_fit results",
}
ROOT_HEADS = {"Machinery": "Arrays, vectors and machinery", "Fitting": "Problems and fits"}

# A dot, blanks and a capital; not the dot of an initial or of a word that is cut short.
SENTENCE_END = re.compile(
    r"(?<=\.)(?<!\b[A-Z]\.)(?<!\bal\.)(?<!\be\.g\.)(?<!\bi\.e\.)(?<!\b[Ff]ig\.)(?<!\b[Ee]q\.)"
    r"(?<!\bcf\.)(?<!\bvs\.)(?<!\bDr\.)\s+(?=[A-Z`])"
)
# What stands around names of types as they print themselves.
OF_TYPES = re.compile(r"<class '|'>|\b(?:jaxtyping|typing|jaxlib\._jax|jaxvision\._vector)\.")


def public_modules(package):
    """The package and its public modules, command lines apart."""
    yield package
    for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if not re.search(r"\._|\.cli$", name):
            yield importlib.import_module(name)


def home(value):
    """The module that defines a function or a class; None for anything else."""
    inner = inspect.unwrap(value) if callable(value) else value
    return inner.__module__ if inspect.isfunction(inner) or inspect.isclass(inner) else None


def entries(package):
    """{name of the entry: the function or class}, one for each public thing of a package."""
    names = defaultdict(list)
    for module in public_modules(package):
        exported = getattr(module, "__all__", ())
        for name in {*exported, *(n for n in vars(module) if not n.startswith("_"))}:
            value = getattr(module, name)
            here = home(value) or (module.__name__ if is_data(name, value, exported) else "")
            if here == module.__name__ or (
                name in exported and here.partition(".")[0] == package.__name__
            ):
                names[id(value)].append((f"{module.__name__}.{name}", value))
    shortest = (min(same, key=lambda e: (e[0].count("."), e[0])) for same in names.values())
    return dict(sorted(shortest))


def is_data(name, value, exported):
    """Whether a package exports a value that is neither function, class nor module."""
    return name in exported and not inspect.ismodule(value) and not name.startswith("_")


def page_of(name, value):
    """The page of a thing: the package or module, just below the root, that defines it."""
    parts = (home(value) or name).split(".")
    below = parts[1] if len(parts) > 1 else BASICS
    return f"{parts[0]}.{BASICS if below.startswith('_') else below}"


def summary(thing):
    """The first sentence of a docstring, or what an alias of types stands for."""
    text = inspect.getdoc(thing) or ""
    if alias := re.fullmatch(r"\w+ = (.*)", text):  # by the name that types print themselves by
        return f"`{OF_TYPES.sub('', alias[1])}`"
    first = SENTENCE_END.split(text.partition("\n\n")[0], maxsplit=1)[0]
    return " ".join(first.split()).removesuffix(":")


def exported(names):
    """Those of the names that a package lists in `__all__`, or that lie in a module just below the
    root, which lists nothing: what users import."""
    found = set()
    for name in names:
        module = importlib.import_module(name.rpartition(".")[0])
        if name.rpartition(".")[2] in getattr(module, "__all__", ()) or name.count(".") < 3:
            found.add(name)
    return found


def directive(name, value):
    kind = "data" if home(value) is None else "class" if inspect.isclass(value) else "function"
    options = {"class": "   :members:\n", "data": "   :no-value:\n"}.get(kind, "")
    return f".. auto{kind}:: {name}\n{options}"


def reference_pages(folder):
    """One page a module: what it exports first, then what its submodules define."""
    folder.mkdir(exist_ok=True)
    pages = defaultdict(dict)
    for package in ROOTS:
        for name, value in entries(package).items():
            pages[page_of(name, value)][name] = value
    offered = exported([name for page in pages.values() for name in page])
    for page, found in pages.items():
        is_basics = page.endswith(f".{BASICS}")
        head = "Arrays and vectors" if is_basics else page
        text = [head, "=" * len(head), ""]
        if not is_basics:
            text += [escaped(summary(importlib.import_module(page))), ""]
        text += [directive(name, value) for name, value in found.items() if name in offered]
        inner = [directive(name, value) for name, value in found.items() if name not in offered]
        if inner:
            text += ["Submodules", "-" * 10, "", *inner]
        write(folder / f"{page}.rst", "\n".join(text))
    for package in ROOTS:
        write(folder / f"{package.__name__}.rst", root_page(package, pages))
    for page in folder.glob("*.rst"):
        if page.stem not in {*pages, *(package.__name__ for package in ROOTS)}:
            page.unlink()  # of a module that is no more
    write(folder / "modules.txt", grouped(pages))
    return pages


def root_page(package, pages):
    """What a package offers by itself, such as `jaxvision.Sphere`, by topic: a line for each name,
    which leads to the entry on the page of its module."""
    places = {id(value): (name, page) for page in pages for name, value in pages[page].items()}
    names = {topic: [] for topic in (*GROUPS, "Modules")}
    for name in sorted(package.__all__, key=str.lower):
        value = getattr(package, name)
        if inspect.ismodule(value):
            topic, place = "Modules", f":doc:`{name} </reference/{value.__name__}>`"
        else:
            entry, page = places[id(value)]
            topic = "Fitting" if package is fitting else group_of(page)
            place = f":py:obj:`{name} <{entry}>`"
        names[topic].append(f"* {place}: {escaped(summary(value))}")
    text = [package.__name__, "=" * len(package.__name__), "", escaped(summary(package)), ""]
    for topic, lines in names.items():
        head = ROOT_HEADS.get(topic, topic)
        text += [head, "-" * len(head), "", *lines, ""] if lines else []
    return "\n".join(text)


def group_of(page):
    """The group of `GROUPS` that a page of the reference is listed in."""
    package, _, name = page.partition(".")
    groups = (group for group, names in GROUPS.items() if name in names.split())
    return "Fitting" if package == "fitting" else next(groups, "Machinery")


def grouped(pages):
    """Lists of modules by `GROUPS`, each with the first sentence of its docstring."""
    lists = {group: [] for group in GROUPS}
    for page in sorted(pages, key=lambda page: page.endswith(f".{BASICS}")):
        if page.endswith(f".{BASICS}"):
            lists["Machinery"].append((page, "Arrays and vectors: types, norms and conversions."))
            continue
        lists[group_of(page)].append((page, summary(importlib.import_module(page))))
    for name in GROUPS["Pictures"].split(), GROUPS["Light"].split():
        assert all(f"jaxvision.{module}" in pages for module in name)
    text = []
    for group, found in lists.items():
        order = {f"jaxvision.{name}": i for i, name in enumerate(GROUPS[group].split())}
        found.sort(key=lambda one: order.get(one[0], len(order)))
        text += [group, "-" * len(group), ""]
        text += [
            f"* :doc:`{page} </reference/{page}>`{': ' if line else ''}{escaped(line)}"
            for page, line in found
        ]
        text += ["", ".. toctree::", "   :hidden:", ""]
        text += [*(f"   /reference/{page}" for page, _ in found), ""]
    return "\n".join(text)


def notebook_pages(folder):
    """The notebooks, which lie outside of the site."""
    folder.mkdir(exist_ok=True)
    for notebook in (HERE.parent / "notebooks").glob("*.ipynb"):
        write(folder / notebook.name, notebook.read_text())


def gallery_pages(folder):
    """A page for each script of the gallery, its picture above its code, and one of them all."""
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
    """Writes the page of one script; returns its card on the gallery's front page."""
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
    """The number of the first line of code."""
    return ast.parse(script.read_text()).body[1].lineno


def write(file, text):
    """Only what changed, so that a second build reads nothing again."""
    if not file.exists() or file.read_text() != text:
        file.write_text(text)


def escaped(text):
    """Plain text with code in backticks, as docstrings have it, as reStructuredText."""
    bullet, text = re.match(r"(\s*(?:\* )?)(.*)", text, flags=re.DOTALL).groups()
    parts = re.split(r"(`[^`]*`)", text)
    plain = [re.sub(r"([*|\\]|_(?!\w))", r"\\\1", part) for part in parts[::2]]
    plain[1:] = [re.sub(r"^(?=[\w^(])", r"\\", part) for part in plain[1:]]  # ends the code before
    return bullet + "".join(p + q for p, q in zip(plain, [*parts[1::2], ""], strict=True))


def escape_types(app, what, name, thing, options, lines):
    """Shapes as `Float[Array, "*picture bands"]` in what napoleon says of attributes."""
    lines[:] = [re.sub(r"(?<!\\)\*", r"\\*", x) if ":vartype" in x else x for x in lines]


def skip_member(app, what, name, thing, skip, options):
    """Fields of a named tuple, which its docstring explains."""
    return True if (inspect.getdoc(thing) or "").startswith("Alias for field") else None


def escape_docstring(app, what, name, thing, options, lines):
    if lines == prepare_docstring(type(thing).__doc__ or ""):
        lines.clear()  # a constant has only the words of its type
    inside = False  # an example, whose text is code
    for i, line in enumerate(lines):
        inside = line.strip().startswith((">>>", "...")) or (inside and bool(line.strip()))
        if not inside:
            lines[i] = escaped(line)


def short_types(app, domain, kind, content):
    """Types without what pydantic checks: `float` for `Annotated[float, FieldInfo(...)]`."""
    for types in app.env.current_document.autodoc_annotations.values():
        types.update({name: without_checks(text) for name, text in types.items()})


def without_checks(text):
    """`Annotated[X, ...]` as X, wherever it stands in a type."""
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


def read_doctree(app, doctree):
    """Names in tables may break after a dot or an underscore; curves that follow each other are one
    grid."""
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
    """{api}`name` leads to the entry of a public name; a name without one fails the build."""

    def __init__(self):
        super().__init__(warn_dangling=True)

    def process_link(self, env, refnode, has_explicit_title, title, target):
        refnode["refdomain"], refnode["reftype"] = "py", "obj"
        return title, target


def find_entry(app, env, node, content):
    """The entry of any other name of the same thing: as another package exports it, or without
    the package."""
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


def setup(app):
    notebook_pages(HERE / "notebooks")
    gallery_pages(HERE / "gallery")
    pages = reference_pages(HERE / "reference")
    places = {id(value): name for page in pages.values() for name, value in page.items()}

    def entry_of(name):
        module, _, last = name.rpartition(".")
        try:
            value = getattr(importlib.import_module(module), last)
        except (ImportError, AttributeError, ValueError):
            return None
        return places.get(id(value))

    app.entry_of = entry_of
    app.add_role("api", Entry())
    app.connect("autodoc-process-docstring", escape_docstring, priority=100)
    app.connect("autodoc-process-docstring", escape_types, priority=900)
    app.connect("autodoc-skip-member", skip_member)
    app.connect("object-description-transform", short_types, priority=100)
    app.connect("doctree-read", read_doctree)
    app.connect("missing-reference", find_entry)
    return {"parallel_read_safe": True}
