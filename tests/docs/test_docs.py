"""Tests of the site: its code runs and prints what the pages say, its pictures are drawn by scripts
short enough to be shown with them, its commands exist, and its reference has an entry for every
public name."""

import ast
import importlib
import importlib.util
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from page_blocks import blocks, kept_promises, printed
from page_blocks import shown as shown_below
from public_names import defined

import fitting
import jaxvision

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MADE = ("gallery/", "reference/", "_build/", "notebooks/")
PAGES = sorted(
    str(page.relative_to(DOCS))
    for page in DOCS.rglob("*.md")
    if not str(page.relative_to(DOCS)).startswith(MADE)
)
APART = {"how-to/use_as_a_library.md"}  # pages where each block of code is independent
WITH_CODE = [page for page in PAGES if blocks((DOCS / page).read_text(), "python")]
SCRIPTS = sorted((DOCS / "gallery").glob("*.py"))
TOOK = re.compile(r"took [\d.]+ s")  # which differs from machine to machine
NUMBER = re.compile(r"-?\b\d+(?:\.\d+)?\b")
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def module(name):
    """Import a module of `docs/`, which is in no package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        return importlib.import_module(name)


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE)
def test_code_runs_and_keeps_its_promises(page, tmp_path, monkeypatch):
    """The code also prints what the page shows below it, and draws the pictures that the page
    shows."""
    text = (DOCS / page).read_text()
    python = blocks(text, "python")
    if any(shown_below(text)):
        monkeypatch.setenv("JAX_ENABLE_X64", "0")  # as a user starts
    said = printed(python, tmp_path, apart=page in APART)
    assert kept_promises(python, said)
    for one, print_out in zip(shown_below(text), said, strict=True):
        if one:
            one, print_out = (TOOK.sub("took", x) for x in (one, print_out))
            assert sorted(NUMBER.sub("", one).split()) == sorted(NUMBER.sub("", print_out).split())
            numbers, found = (np.array(NUMBER.findall(x), float) for x in (one, print_out))
            np.testing.assert_allclose(found, numbers, rtol=0.02)
    for picture in re.findall(r"_static/(\w+\.png)", text):
        assert_alike(tmp_path / picture, DOCS / "_static" / picture)


def assert_alike(drawn, kept):
    """Check that two pictures are equal, except for the edges of letters."""
    ours, theirs = coarse(drawn), coarse(kept)
    assert ours.shape == theirs.shape
    apart = abs(ours - theirs)
    assert apart.mean() < 0.01
    assert (apart > 0.1).mean() < 0.003


def test_pages_are_found():
    assert {"tutorial.md", "how-to/extend.md"} <= set(WITH_CODE)


def test_commands_exist():
    from typer.main import get_command

    import fitting.cli
    import jaxvision.cli

    known = {
        "jaxvision": get_command(jaxvision.cli.app),
        "jaxvision-fit": get_command(fitting.cli.app),
    }
    text = "\n".join(block for page in PAGES for block in blocks((DOCS / page).read_text(), "sh"))
    lines = re.findall(r"^(jaxvision(?:-fit)?) (\S+)(.*)$", text, flags=re.MULTILINE)
    assert len(lines) > 5
    for name, command, rest in lines:
        options = {o for p in known[name].commands[command].params for o in p.opts}
        assert set(re.findall(r"--[a-z-]+", rest.partition("#")[0])) <= options, (name, command)


def test_every_key_of_a_file_has_a_meaning(tmp_path):
    # in a new process, where no test has registered types of record
    make = "import pathlib, sys, file_keys; file_keys.key_pages(pathlib.Path(sys.argv[1]))"
    subprocess.run([sys.executable, "-c", make, str(tmp_path)], cwd=DOCS, check=True)
    row = re.compile(r"^\| `(\w+)` \| (.*) \| [^|]+ \|$", re.MULTILINE)
    found = [key for page in sorted(tmp_path.iterdir()) for key in row.findall(page.read_text())]
    assert len(found) > 280
    assert not [key for key, meaning in found if not meaning.partition("One of")[0].strip()]
    assert {said for key, said in found if key == "sigma"} == {
        "degrees, standard deviation of the facets' slope angle, in [0, 90]."
    }  # the record's field is in radians


def test_the_terms_link_to_each_textbook_figure():
    """Each figure has at most 15 lines of code and a stored picture."""
    cells = json.loads((ROOT / "notebooks" / "textbook_figures.ipynb").read_text())["cells"]
    page = (DOCS / "notions.md").read_text()
    titles = [head[1] for c in cells if (head := re.match("## (.+)", "".join(c["source"])))]
    figures = [cell for cell in cells if cell["cell_type"] == "code"][1:]  # after the imports
    for number, (title, cell) in enumerate(zip(titles, figures, strict=True), 1):
        assert title.startswith(f"{number}. ")
        anchor = re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
        assert f"\n[figure {number}]: notebooks/textbook_figures.ipynb#{anchor}\n" in page
        assert f", [figure {number}] |\n" in page
        assert len(cell["source"]) <= 15
        assert any({"image/png", "image/jpeg"} & o.get("data", {}).keys() for o in cell["outputs"])
    assert len(figures) == 12


def shown(file):
    """Return the Python that a reader copies from a notebook, a script or a page."""
    if file.suffix == ".ipynb":
        cells = json.loads(file.read_text())["cells"]
        return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    return (
        file.read_text() if file.suffix == ".py" else "\n".join(blocks(file.read_text(), "python"))
    )


def is_module(name):
    return importlib.util.find_spec(name) is not None


def internals(code):
    """Yield the imports from the two packages that are private or do not exist."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            names = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "", alias.name) for alias in node.names]
        else:
            continue
        for module, name in names:
            if module.partition(".")[0] not in ("jaxvision", "fitting"):
                continue
            within = importlib.import_module(module)
            if name and not hasattr(within, name) and not is_module(f"{module}.{name}"):
                yield f"{module}.{name}"
                continue
            offered = getattr(within, "__all__", None)
            is_public = (
                module.count(".") < 2 if offered is None or name is None else name in offered
            )
            if not is_public or re.search(r"(^|\.)_", f"{module}.{name}"):
                yield f"{module}.{name}" if name else module


@pytest.mark.parametrize(
    "file",
    [*NOTEBOOKS, *SCRIPTS, *(DOCS / page for page in WITH_CODE), ROOT / "README.md"],
    ids=lambda file: file.name,
)
def test_code_for_readers_imports_only_public_names(file):
    assert not list(internals(shown(file)))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_scripts_fit_beside_their_pictures(script):
    assert script.with_suffix(".png").exists()
    text = script.read_text()
    code = ast.parse(text).body[1:]
    assert len(text.splitlines()) - code[0].lineno + 1 <= 30
    title, _, said = ast.get_docstring(ast.parse(text)).partition("\n\n")
    assert title
    assert said.endswith(".")


def test_the_gallery_is_no_smaller_than_promised_and_light():
    assert len(SCRIPTS) >= 24
    assert sum(s.with_suffix(".png").stat().st_size for s in SCRIPTS) < 3e6


def test_the_gallery_shows_every_script_under_one_topic():
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("the `docs` extra is not installed")
    topics = module("site_pages").GALLERY
    shown = [name for names in topics.values() for name in names.split()]
    assert sorted(shown) == [script.stem for script in SCRIPTS]


def coarse(picture):
    """Return means over 4 x 4 pixels, where the edges of letters matter little."""
    pixels = plt.imread(picture)[..., :3]
    rows, columns = (size // 4 for size in pixels.shape[:2])
    return pixels[: 4 * rows, : 4 * columns].reshape(rows, 4, columns, 4, 3).mean((1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_pictures_are_drawn(script, tmp_path):
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # as a user
        drawn = module("draw_gallery").draw(script, tmp_path)
    assert_alike(drawn, script.with_suffix(".png"))


def test_every_public_name_has_one_entry():
    """The generator of the pages is compared with the names that the tests of the public API
    discover."""
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("the `docs` extra is not installed")
    pages = module("reference_pages")
    for package in (jaxvision, fitting):
        entries = pages.entries(package)
        named = {id(value) for value in entries.values() if pages.home(value)}
        assert named == {id(value) for _, value in defined(package)}
        assert len({id(value) for value in entries.values()}) == len(entries)
        assert all(
            getattr(sys.modules[n.rpartition(".")[0]], n.rpartition(".")[2]) for n in entries
        )


def test_functions_in_the_table_of_errors_link_to_their_rows(tmp_path):
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("the `docs` extra is not installed")
    site = module("site_pages")
    pages = module("reference_pages").reference_pages(tmp_path)
    places = {id(value): name for page in pages.values() for name, value in page.items()}
    rows = site.rows_of_errors(site.finder(places))
    names = set(re.findall(r"^\| `([\w.]+)", (DOCS / "errors.md").read_text(), re.MULTILINE))
    public = {f"{package.__name__}.{name}" for package in (jaxvision, fitting) for name in names}
    wanted = {places[id(value)] for name, value in defined(jaxvision) if name in public}
    wanted |= {places[id(value)] for name, value in defined(fitting) if name in public}
    assert len(wanted) > 200
    assert wanted <= rows.keys()
    app = SimpleNamespace(rows_of_errors=rows)
    for name in wanted:
        lines = []
        site.link_errors(app, "function", name, None, None, lines)
        assert rows[name] in lines[1]


def test_the_pages_of_the_roots_name_all_that_they_offer(tmp_path):
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("the `docs` extra is not installed")
    module("reference_pages").reference_pages(tmp_path)
    for package in (jaxvision, fitting):
        page = (tmp_path / f"{package.__name__}.rst").read_text()
        named = re.findall(r"^\* .*?`(\w+) <", page, re.MULTILINE)
        assert sorted(named) == sorted(package.__all__)


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("An image (Szeliski, fig. 3.3), drawn. More.", "An image (Szeliski, fig. 3.3), drawn."),
        ("As J. Kajiya has it, e.g. here.\n\nMore.", "As J. Kajiya has it, e.g. here."),
        ("Of Astier et al. (2019)\nin two lines. `x` is.", "Of Astier et al. (2019) in two lines."),
        ("Of the room, by definition:", "Of the room, by definition"),
        ("X = <class 'jaxtyping.Float[jaxlib._jax.Array, 'a']'>", '`Float[Array, "a"]`'),
    ],
)
def test_summaries_are_whole_sentences(text, first):
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("the `docs` extra is not installed")
    thing = type("Thing", (), {"__doc__": text})
    assert module("reference_pages").summary(thing) == first


def test_the_page_on_installing_agrees_with_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    page = (DOCS / "install.md").read_text()
    extras = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert sorted(extras) == sorted(project["optional-dependencies"])
    versions = [c.rpartition(" ")[2] for c in project["classifiers"] if "Python :: 3." in c]
    assert set(versions) == set(re.findall(r"3\.\d+", page))
    readme = (ROOT / "README.md").read_text()
    assert "pip install 'jax[cuda13]'" in page
    command = "-m venv .venv && .venv/bin/pip install ."
    assert command in page
    assert command in readme


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("dict[str, ~jaxtyping.Float[jaxlib._jax.Array, 'a b']]", 'dict[str, Float[Array, "a b"]]'),
        ("tuple[jaxvision.Filtered, ...]", 'tuple[Float[Array, "*filtered"], ...]'),
        ("jaxvision.View | None", "jaxvision.scene.View | None"),
        ("~jaxvision.scene.surfaces.Scene", "~jaxvision.Scene"),
        ("typing.Annotated[float, Gt(gt=0)]", "float"),
    ],
)
def test_types_are_written_as_code_does(text, plain):
    from jaxvision import scene
    from jaxvision.filters import padding

    names = vars(padding) | {"View": scene.View}
    entries = {id(scene.View): "jaxvision.scene.View", id(scene.Scene): "jaxvision.Scene"}
    found = module("site_text").plain_type(text, names, lambda value: entries.get(id(value)))
    assert found == plain


def test_hooks_before_a_commit_run_what_ci_runs():
    hooks = re.findall(r"entry: (.*)", (ROOT / ".pre-commit-config.yaml").read_text())
    run = (ROOT / ".ci" / "run").read_text()
    linted = re.findall(
        r"^\.venv/bin/((?:ruff|pyright).*?)(?: --pythonpath .*)?$", run, re.MULTILINE
    )
    assert hooks == linted
    named = re.findall(
        r"`((?:jaxvision|fitting)/[\w/]+(?:\.py)?/?)`", (ROOT / "CONTRIBUTING.md").read_text()
    )
    assert named
    assert not [place for place in named if not (ROOT / place).exists()]
