"""Tests imports, read from the source: dependencies go one way, and `import jaxvision` is fast."""

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# A module may import only from lower floors, and modules on one floor never import each other. A
# module or folder of `jaxvision` that is not listed here is an error.
FLOORS = [
    {"_textbook"},
    {"errors", "programs"},
    {"core"},
    {"scene", "spectra", "filters", "point_ops", "histogram", "tasks"},
    {"geometry", "colour_spaces", "matting"},
    {"lights", "brdf", "optics", "sensor"},
    {"rendering", "development"},
    {"transport"},
    {"effects"},
    {"shot", "files", "plots"},
    {"render_command"},
    {"accuracy"},
    {"cli"},
    {"__main__"},
]
# The part of `jaxvision` without lights, surfaces and cameras.
KNOWN_TO_INFERENCE = {
    "jaxvision.errors",
    "jaxvision.programs",
    "jaxvision.core.in_notebooks",
    "jaxvision.core.lazy_names",
    "jaxvision.core.plain_arrays",
    "jaxvision.core.parallel_loops",
    "jaxvision.files.images",
}
STAGES = ["read", "model", "fit", "calibration", "findings", "figures", "section"]
FITTING_FLOORS = [
    {"rig", "inference", "codes", "copies"},
    {"frame_checks", "observation", "poisson", "report", "rig_from_folder"},
    {"fits", "sensor_likelihoods"},
    {"lights", "noise", "resolution", "response", "sensitivities"},
    {"reflectance"},
    {"accuracy", "demo", "joint"},
    {"checks"},
    {"folders"},
    {"study", "commands"},
    {"cli"},
    {"__main__"},
]
NEVER_IN_JAXVISION = {"fitting", "optimistix", "jaxopt", "emcee", "xarray"}
NEVER_ON_IMPORT = [
    "matplotlib",
    "OpenImageIO",
    "scipy",
    "colour",
    "lineax",
    "trimesh",
    "rawpy",
    "astropy",
    "embreex",
    "pydantic",
    "optimistix",
    "jaxopt",
    "emcee",
    "xarray",
]


def running(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Yield the statements, including nested ones, except those for type checkers only."""
    for node in nodes:
        yield node
        parts = ["body", "orelse", "handlers", "finalbody", "cases"]
        test = getattr(node, "test", None)
        if "TYPE_CHECKING" in (getattr(test, "id", ""), getattr(test, "attr", "")):
            parts.remove("body")
        for part in parts:
            yield from running(getattr(node, part, []))


@cache
def imports(file: Path) -> set[str]:
    """Return the absolute dotted names that a file imports when it runs, with relative ones
    resolved."""
    package = list(file.relative_to(ROOT).parent.parts)
    found = set()
    for node in running(ast.parse(file.read_text()).body):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join(base + (node.module.split(".") if node.module else []))
            found |= {name} | {f"{name}.{alias.name}" for alias in node.names}
    return found


@cache
def offered(package: str) -> dict[str, str]:
    """Return the module that defines each name exported by a package, from its stub."""
    stub = ROOT / package / "__init__.pyi"
    nodes = [node for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ImportFrom)]
    return {
        alias.asname or alias.name: f"{package}.{node.module}"
        for node in nodes
        if node.module is not None
        for alias in node.names
    }


def where_defined(name: str) -> str:
    """Return the full name: `jaxvision.render` is `jaxvision.rendering.direct.render`."""
    package, _, rest = name.partition(".")
    if package not in ("jaxvision", "fitting") or rest not in offered(package):
        return name
    return f"{offered(package)[rest]}.{rest}"


@cache
def files_of_rooms(package: str) -> dict[str, list[Path]]:
    """Return the files of each top-level module of a package. A sub-package counts as one
    module."""
    found: dict[str, list[Path]] = {}
    for file in sorted((ROOT / package).rglob("*.py")):
        parts = file.relative_to(ROOT / package).with_suffix("").parts
        if parts != ("__init__",):
            found.setdefault(parts[0], []).append(file)
    return found


@cache
def rooms(package: str) -> dict[str, set[str]]:
    """Return the imports of each module, by where the names are defined."""
    return {
        room: {where_defined(name) for file in files for name in imports(file)}
        for room, files in files_of_rooms(package).items()
    }


def neighbours(package: str) -> dict[str, set[str]]:
    """Return the modules of the same package that each module imports."""
    plan = rooms(package)
    return {
        room: {
            name.split(".")[1]
            for name in names
            if name.startswith(f"{package}.") and name.split(".")[1] in plan.keys() - {room}
        }
        for room, names in plan.items()
    }


def outside(names: set[str]) -> set[str]:
    return {name.split(".")[0] for name in names}


def test_the_reader_of_imports_finds_known_ones():
    """Three imports that are known to exist must be found."""
    plan = neighbours("jaxvision")
    assert where_defined("jaxvision.render").startswith("jaxvision.rendering.")
    assert {"geometry", "scene", "core"} <= plan["brdf"]
    assert {"sensor", "optics", "rendering"} <= plan["shot"]
    assert "jax" in outside(rooms("jaxvision")["sensor"])


@pytest.mark.parametrize("room", sorted(files_of_rooms("jaxvision")))
def test_dependencies_go_one_way(room):
    floor = {name: i for i, names in enumerate(FLOORS) for name in names}
    assert room in floor, f"give jaxvision/{room} its floor in {__name__}"
    wrong = {other for other in neighbours("jaxvision")[room] if floor[other] >= floor[room]}
    assert not wrong, f"jaxvision/{room} must not import {sorted(wrong)}"


def _kinds() -> tuple[set[str], set[str]]:
    """Return the modules that register a light or a material, and the records that they define."""
    modules, records = set(), set()
    for file in [
        *(ROOT / "jaxvision/lights").glob("*.py"),
        *(ROOT / "jaxvision/brdf").glob("*.py"),
    ]:
        text = file.read_text()
        if re.search(r"^ *register\w*\(", text, re.MULTILINE) and not file.name.startswith("_"):
            modules.add(".".join(file.relative_to(ROOT).with_suffix("").parts))
            records |= {
                node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)
            }
    return modules, records


@pytest.mark.parametrize(
    "place",
    [
        "effects",
        "files/scenes",
        "files/records.py",
        "files/toml.py",
        "files/cameras.py",
        "files/materials.py",
    ],
)
def test_modules_for_all_types_import_no_single_type(place):
    """Effects and file readers ask the registries, because each type brings its own bound and
    keys."""
    modules, records = _kinds()
    assert {"jaxvision.lights.point", "jaxvision.brdf.phong", "jaxvision.brdf.measured"} <= modules
    path = ROOT / "jaxvision" / place
    assert path.exists()
    taken = {
        name
        for file in [*path.rglob("*.py")] or [path]
        for name in imports(file)
        if name in modules or (name.startswith("jaxvision.") and name.rpartition(".")[2] in records)
    }
    assert not taken, f"jaxvision/{place} must ask the registry instead of {sorted(taken)}"


def test_scene_contains_only_records():
    taken = {name for name in rooms("jaxvision")["scene"] if name.startswith("jaxvision.core.")}
    modules = ("_maps", "_shown", "_types", "_warnings", "lazy_names")
    known = {f"jaxvision.core.{module}" for module in modules}
    assert neighbours("jaxvision")["scene"] == {"core"}
    assert {".".join(name.split(".")[:3]) for name in taken} == known
    files = (ROOT / "jaxvision" / "scene").glob("*.py")
    nodes = [node for file in files for node in ast.parse(file.read_text()).body]
    for record in (node for node in nodes if isinstance(node, ast.ClassDef)):
        methods = {node.name for node in record.body if isinstance(node, ast.FunctionDef)}
        assert methods <= {"__check_init__"}, f"{record.name} has behaviour: {methods}"


@pytest.mark.parametrize("room", sorted(files_of_rooms("jaxvision")))
def test_jaxvision_imports_no_solver(room):
    assert not outside(rooms("jaxvision")[room]) & NEVER_IN_JAXVISION


OWN_LOOPS = {  # direct loops of jax.lax, which jaxlib 0.12 compiles for one core
    "jaxvision/core/parallel_loops.py",
    "jaxvision/accuracy/rounding.py",  # loops of the evaluated program
    "fitting/inference/newton.py",  # calls LAPACK in each step, which XLA does not parallelise
    "fitting/inference/nuts.py",  # around the loops of blackjax
    "fitting/inference/separable.py",  # over a few numbers
}


def test_loops_run_on_all_cores():
    loop = re.compile(r"\blax\.(scan|map|fori_loop|while_loop)\(")
    files = [file for name in ("jaxvision", "fitting") for file in (ROOT / name).rglob("*.py")]
    found = {str(file.relative_to(ROOT)) for file in files if loop.search(file.read_text())}
    assert found == OWN_LOOPS


@pytest.mark.parametrize("room", sorted(files_of_rooms("fitting")))
def test_a_calibration_goes_one_way(room):
    floor = {name: i for i, names in enumerate(FITTING_FLOORS) for name in names}
    assert room in floor, f"give fitting/{room} its floor in {__name__}"
    wrong = {other for other in neighbours("fitting")[room] if floor[other] >= floor[room]}
    assert not wrong, f"fitting/{room} must not import {sorted(wrong)}"


@pytest.mark.parametrize(
    "folder", ["noise", "response", "reflectance/from_images", "reflectance/from_files", "joint"]
)
def test_the_stages_of_a_calibration_follow_each_other(folder):
    room = ROOT / "fitting" / folder
    assert {f"{stage}.py" for stage in ("read", *STAGES[3:])} <= {
        file.name for file in room.iterdir()
    }
    package = ".".join(room.relative_to(ROOT).parts)
    for place, stage in enumerate(STAGES):
        file = room / f"{stage}.py"
        names = imports(file) if file.exists() else set()
        wrong = {later for later in STAGES[place:] if f"{package}.{later}" in names}
        assert not wrong, f"{package}.{stage} must not import {sorted(wrong)}"


def test_inference_imports_no_physics_and_no_calibration():
    assert not neighbours("fitting")["inference"]
    files = (ROOT / "jaxvision").rglob("*.py")
    modules = {".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files}
    assert rooms("fitting")["inference"] & modules == KNOWN_TO_INFERENCE


def test_image_and_file_calibrations_are_independent():
    """Calibrations in one folder use shared modules, but not each other."""
    for one, other in [("from_files", "from_images"), ("from_images", "from_files")]:
        for file in (ROOT / "fitting" / "reflectance" / one).glob("*.py"):
            taken = {name for name in imports(file) if f"reflectance.{other}" in name}
            assert not taken, f"{file} must not import {sorted(taken)}"
    for file in (ROOT / "fitting" / "noise").glob("*.py"):
        taken = {name for name in imports(file) if "noise.across_settings" in name}
        assert not taken, f"{file} must not import {sorted(taken)}"


@pytest.mark.parametrize("package", ["jaxvision", "fitting"])
def test_no_cycles(package):
    plan = {room: set(others) for room, others in neighbours(package).items()}
    while plan:
        leaves = {room for room, others in plan.items() if not others & plan.keys()}
        assert leaves, f"{package} has a cycle among {sorted(plan)}"
        plan = {room: others for room, others in plan.items() if room not in leaves}


@pytest.mark.parametrize("package", ["jaxvision", "fitting"])
def test_no_function_hides_a_module(package):
    """`import jaxvision.shot as s` gives the module, whatever the packages around it export."""
    hidden = []
    for file in sorted((ROOT / package).rglob("*.py")):
        *above, name = file.relative_to(ROOT).with_suffix("").parts
        if name != "__init__":
            module = importlib.import_module(".".join([*above, name]))
            if getattr(sys.modules[".".join(above)], name) is not module:
                hidden.append(module.__name__)
    assert not hidden


def borrowed(package: str) -> set[str]:
    """Return the private names that modules import from other modules."""
    found = set()
    for room, files in files_of_rooms(package).items():
        for name in set[str]().union(*map(imports, files)):
            owner, *inner = name.split(".")
            if owner == package:
                inner = [] if inner[:1] == [room] else inner[2 if inner[:1] == ["core"] else 1 :]
            if owner in ("jaxvision", "fitting") and any(
                re.match("_(?!_)", part) for part in inner
            ):
                found.add(name)
    return found


# Private names imported from other modules so far. The list may only shrink.
BORROWED = {
    "jaxvision": set(),
    "fitting": set(),
}


@pytest.mark.parametrize("package", ["jaxvision", "fitting"])
def test_private_names_stay_in_their_module(package):
    assert borrowed(package) <= BORROWED[package]


def loaded_by(program: str) -> tuple[set[str], str]:
    """Return the modules loaded in a new process when a program ends, and its standard error."""
    listing = "import atexit, sys; atexit.register(lambda: print('\\nLOADED', *sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", f"{listing}\n{program}"], cwd=ROOT, capture_output=True, text=True
    )
    modules = done.stdout.rpartition("\nLOADED")[2].split()
    return {name.split(".")[0] for name in modules}, done.stderr


OF_TYPER = {"pydantic"}  # loaded for given options


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("command", "arguments", "allowed"),
    [
        ("jaxvision", ["--help"], set()),
        ("jaxvision", ["--version"], OF_TYPER),
        ("jaxvision", ["render", "--help"], OF_TYPER),
        ("jaxvision", ["inspect", "no_such_file.png"], OF_TYPER | {"numpy"}),
        ("jaxvision", ["render", "no_scene", "--out", "a.exr"], OF_TYPER),
        ("jaxvision", ["effects", "cornell_box", "--camera", "no_camera"], OF_TYPER),
        ("jaxvision", ["accuracy", "no_scene.toml"], OF_TYPER),
        ("fitting", ["--help"], set()),
        ("fitting", ["accuracy", "no_rig"], OF_TYPER),
        ("fitting", ["brdf", "--help"], OF_TYPER),
    ],
)
def test_help_and_a_wrong_path_load_no_numerical_library(command, arguments, allowed):
    loaded, stderr = loaded_by(f"from {command}.cli import app; app({arguments})")
    assert "jaxvision" in loaded, stderr
    assert not loaded & {"jax", "numpy", *NEVER_ON_IMPORT} - allowed


@pytest.mark.parametrize(("package", "name"), [("jaxvision", "capture"), ("fitting", "Problem")])
def test_the_names_of_a_package_load_nothing(package, name):
    loaded, stderr = loaded_by(f"import {package}; assert {name!r} in dir({package})")
    assert package in loaded, stderr
    assert not loaded & {"jax", "numpy", *NEVER_ON_IMPORT}


def test_names_load_when_first_used_also_in_a_trace():
    """`import jaxvision` comes first, and any name is used later."""
    loaded, stderr = loaded_by(
        "import sys, jax, jaxvision\n"
        "def f(x):\n"
        "    for name in jaxvision.__all__:\n"
        "        if name != 'files':\n"
        "            getattr(jaxvision, name)\n"
        "    jaxvision.transport.radiosity.radiosity\n"
        "    for name in jaxvision.filters.__all__:\n"
        "        if 'matrix' not in name.lower() and 'scipy' not in name:\n"
        "            getattr(jaxvision.filters, name)\n"
        "    return x\n"
        "jax.make_jaxpr(f)(1.0)\n"
        "values = [v for name, module in [*sys.modules.items()]"
        " if name.startswith('jaxvision') for v in vars(module).values()]\n"
        "values += [w for v in values if isinstance(v, dict) for w in v.values()]\n"
        "values = [v for v in values if not isinstance(v, dict)]\n"
        "assert not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))\n"
    )
    assert not stderr
    assert "jax" in loaded
    assert not loaded & set(NEVER_ON_IMPORT)
