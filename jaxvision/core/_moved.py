"""Keep former module names valid, such as `jaxvision.io`. Imports, attributes and pickles with a
former name find the module under its new name, with a `DeprecationWarning`."""

import sys
import warnings
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    f"jaxvision.{old}": f"jaxvision.{new}"
    for old, new in {
        "_vector": "core._vector",  # in pickles of records
        "camera_files": "files.cameras",
        "colour_data": "colour_spaces.colour_data",
        "colour_filters": "sensor.colour_filters",
        "command_line": "cli.command_line",
        "compositing": "matting.compositing",
        "gltf_files": "files.gltf",
        "hemisphere": "geometry.hemisphere",
        "hemisphere_integral": "rendering.hemisphere_integral",
        "image_settings": "files.image_settings",
        "in_notebooks": "core.in_notebooks",
        "interrupts": "core.interrupts",
        "io": "files.images",
        "lazy_names": "core.lazy_names",
        "lifted_scene": "rendering.lifted_scene",
        "material_files": "files.materials",
        "measured_files": "files.measured",
        "memory": "core.memory",
        "mesh_files": "files.meshes",
        "padding": "filters.padding",
        "plain_arrays": "core.plain_arrays",
        "progress": "core.progress",
        "raw_files": "files.raw",
        "record_files": "files.records",
        "scene_checks": "rendering.scene_checks",
        "scene_files": "files.scenes",
        "shading": "rendering.shading",
        "shadows": "rendering.shadows",
        "side_by_side": "core.side_by_side",
        "toml_files": "files.toml",
    }.items()
}

RENAMED = {  # public functions
    "fitting.by_channel": "stack_channels",
    "fitting.reflectance.from_files.of_axis": "best_about_axis",
    "jaxvision.brdf.one_way": "draw_way",
    "jaxvision.brdf.passing": "transmitted",
    "jaxvision.filters.continued": "pad_axis",
    "jaxvision.geometry.reach_of": "largest_coordinate",
    "jaxvision.lights.seen": "radiance_along",
    "jaxvision.point_ops.with_luminance": "set_luminance",
    "jaxvision.rendering.each": "map_rays",
    "jaxvision.sensor.at_iso": "set_iso",
    "jaxvision.tasks.in_order": "map_ordered",
    "jaxvision.transport.radiosity.by_patch": "patch_means",
}


def renamed(old: str) -> str | None:
    """Return the new name of a renamed public function, with a warning; None for any other name."""
    new = RENAMED.get(old)
    if new is not None:
        warnings.warn(
            f"{old} is now {old.rpartition('.')[0]}.{new}.", DeprecationWarning, stacklevel=3
        )
    return new


def module_of(old: str) -> ModuleType | None:
    """Return the module that formerly had this name, with a warning; None for any other name."""
    if old not in MOVED:
        return None
    _warn(old, stacklevel=4)
    package, _, name = old.rpartition(".")
    module = import_module(MOVED[old])
    setattr(sys.modules[package], name, module)  # one warning is enough
    return module


def find_modules_by_old_names() -> None:
    """Register an import hook that finds modules by their former names."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())  # before Python looks for files in a moved package


class _Finder:
    def find_spec(
        self, fullname: str, path: object, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target
        if not fullname.startswith("jaxvision."):
            return None
        top = ".".join(fullname.split(".", 2)[:2])
        if top not in MOVED:
            return None
        if fullname == top:
            _warn(top, stacklevel=3)
        return ModuleSpec(fullname, _Moved(MOVED[top] + fullname.removeprefix(top)))


class _Moved(Loader):
    """Loads a module under its former name."""

    def __init__(self, new: str) -> None:
        self.new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        del spec
        module = import_module(self.new)
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.own


def _warn(old: str, *, stacklevel: int) -> None:
    warnings.warn(f"{old} is now {MOVED[old]}.", DeprecationWarning, stacklevel=stacklevel)
