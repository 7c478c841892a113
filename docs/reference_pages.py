"""Generates the pages of the reference from the packages: one page per module and per submodule.
Every public name has one entry, under the shortest path by which it can be imported. Links to other
names of the same object, and names without their package, lead to that entry.
"""

import importlib
import inspect
import pkgutil
import re
from collections import defaultdict

from site_text import escaped, explained, plain_type, write

import fitting
import jaxvision

ROOTS = jaxvision, fitting
BASICS = "arrays"  # the page of names defined at the root of `jaxvision`: types, vectors, norms
GROUPS = {  # on the reference's front page; modules in no group count as machinery
    "Scenes and surfaces": "scene geometry brdf rendering transport effects",
    "Light": "lights spectra",
    "Cameras and sensors": "shot optics sensor development",
    "Pictures": "filters point_ops colour_spaces histogram matting plots",
    "Files and commands": "files render_command tasks cli",
    "Accuracy": "accuracy",
    "Fitting": "fitting",
    "Machinery": "",
}
TOPICS = {  # of what `jaxvision` itself offers, by the module that defines it
    "Scenes": "scene.shapes scene.surfaces geometry rendering.lifted_scene",
    "Materials": "brdf",
    "Lights": "lights scene.light",
    "Rendering": "rendering transport",
    "Views and lenses": "scene.views scene.lenses optics",
    "Cameras and sensors": "scene.camera scene.sensors scene.sensor_effects scene.noises sensor "
    "shot",
    "Development and pictures": "scene.developments development point_ops",
    "Files": "files",
    "Arrays, vectors and machinery": "",
    "Problems and fits": "",
    "Modules": "",
}

# A dot, blanks and a capital, but not the dot of an initial or an abbreviation.
SENTENCE_END = re.compile(
    r"(?<=\.)(?<!\b[A-Z]\.)(?<!\bal\.)(?<!\be\.g\.)(?<!\bi\.e\.)(?<!\b[Ff]ig\.)(?<!\b[Ee]q\.)"
    r"(?<!\bcf\.)(?<!\bvs\.)(?<!\bDr\.)\s+(?=[A-Z`])"
)


def public_modules(package):
    """Return the package and its public modules, except modules of command lines."""
    yield package
    for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if not re.search(r"\._|\.cli$", name):
            yield importlib.import_module(name)


def home(value):
    """Return the module that defines a function or a class, and None for other objects."""
    inner = inspect.unwrap(value) if callable(value) else value
    return inner.__module__ if inspect.isfunction(inner) or inspect.isclass(inner) else None


def entries(package):
    """Return {name of the entry: function or class} for each public object of a package."""
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
    """Return whether a package exports a value that is neither function, class nor module."""
    return name in exported and not inspect.ismodule(value) and not name.startswith("_")


def page_of(name, value):
    """Return the page of an object: the package or module, just below the root, that defines it."""
    parts = (home(value) or name).split(".")
    below = parts[1] if len(parts) > 1 else BASICS
    return f"{parts[0]}.{BASICS if below == 'core' else below}"


def summary(thing):
    """Return the first sentence of a docstring, or the definition of a type alias."""
    text = inspect.getdoc(thing) or ""
    if alias := re.fullmatch(r"\w+ = (.*)", text):  # by the name that types print themselves by
        return f"`{plain_type(alias[1])}`"
    first = SENTENCE_END.split(text.partition("\n\n")[0], maxsplit=1)[0]
    return " ".join(first.split()).removesuffix(":")


def exported(names):
    """Return the names that users import: those in the `__all__` of a package, or those of a module
    just below the root that has no `__all__`.
    """
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
    """Write one page for the exported names of each module, and one for each of its submodules."""
    folder.mkdir(exist_ok=True)
    pages = defaultdict(dict)
    for package in ROOTS:
        for name, value in entries(package).items():
            pages[page_of(name, value)][name] = value
    offered = exported([name for page in pages.values() for name in page])
    made = {package.__name__: root_page(package, pages) for package in ROOTS}
    for page, found in pages.items():
        is_basics = page.endswith(f".{BASICS}")
        text = headed("Arrays and vectors" if is_basics else page, "=")
        if not is_basics:
            text += explained(inspect.getdoc(importlib.import_module(page)) or "")
        text += [directive(name, value) for name, value in found.items() if name in offered]
        inner = defaultdict(dict)
        for name, value in found.items():
            if name not in offered:
                inner[name.rpartition(".")[0]][name] = value
        if inner:
            text += headed("Submodules", "-")
            text += [line_of(submodule) for submodule in sorted(inner)]
        made[page] = "\n".join([*text, ""])
        for submodule, own in inner.items():
            made[submodule] = submodule_page(page, submodule, own)
    for page, text in made.items():
        write(folder / f"{page}.rst", text)
    for page in folder.glob("*.rst"):
        if page.stem not in made:
            page.unlink()  # its module no longer exists
    write(folder / "modules.txt", grouped(pages))
    return pages


def headed(title, rule):
    return [title, rule * len(title), ""]


def line_of(module):
    """Return a link to the page of a module, with the first sentence of its docstring."""
    said = escaped(summary(importlib.import_module(module)))
    return f"* :doc:`{module} </reference/{module}>`{': ' if said else ''}{said}"


def submodule_page(page, submodule, own):
    """Return the separate page of a submodule, without which the page of its module would be too
    long.
    """
    text = [":orphan:", ":nosearch:", "", *headed(submodule, "=")]
    text += explained(inspect.getdoc(importlib.import_module(submodule)) or "")
    text += [f"A part of :doc:`{page} </reference/{page}>`, whose page has what users import.", ""]
    return "\n".join([*text, *(directive(name, value) for name, value in own.items())])


def root_page(package, pages):
    """Return the page of a root package, which lists its names, such as `jaxvision.Sphere`, by
    topic: one line per name, with a link to the entry on the page of its module.
    """
    places = {id(value): name for found in pages.values() for name, value in found.items()}
    names = {topic: [] for topic in TOPICS}
    for name in sorted(package.__all__, key=str.lower):
        value = getattr(package, name)
        if inspect.ismodule(value):
            topic, place = "Modules", f":doc:`{name} </reference/{value.__name__}>`"
        else:
            entry = places[id(value)]
            topic = "Problems and fits" if package is fitting else topic_of(value)
            place = f":py:obj:`{name} <{entry}>`"
        names[topic].append(f"* {place}: {escaped(summary(value))}")
    text = [*headed(package.__name__, "="), *explained(inspect.getdoc(package) or "")]
    for topic, lines in names.items():
        text += [*headed(topic, "-"), *lines, ""] if lines else []
    return "\n".join(text)


def topic_of(value):
    """Return the topic in `TOPICS` of the innermost module that contains a value's definition."""
    topics = {
        f"jaxvision.{name}": topic for topic, names in TOPICS.items() for name in names.split()
    }
    module = home(value) or ""
    while module and module not in topics:
        module = module.rpartition(".")[0]
    return topics.get(module, "Arrays, vectors and machinery")


def group_of(page):
    """Return the group in `GROUPS` to which a page of the reference belongs."""
    package, _, name = page.partition(".")
    groups = (group for group, names in GROUPS.items() if name in names.split())
    return "Fitting" if package == "fitting" else next(groups, "Machinery")


def grouped(pages):
    """Return lists of modules for the `GROUPS`, each module with the first sentence of its
    docstring.
    """
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
        text += headed(group, "-")
        text += [
            f"* :doc:`{page} </reference/{page}>`{': ' if line else ''}{escaped(line)}"
            for page, line in found
        ]
        text += ["", ".. toctree::", "   :hidden:", ""]
        text += [*(f"   /reference/{page}" for page, _ in found), ""]
    return "\n".join(text)
