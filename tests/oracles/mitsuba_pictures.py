"""Scenes in Mitsuba's XML, and Mitsuba's own pictures of them (12 x 16 pixels) in
`mitsuba_pictures.npz`.

    PYTHONPATH=tests python tests/oracles/mitsuba_pictures.py

makes the pictures again: means of 16 pictures of 16,384 samples each, with the standard errors of
these means. It needs Mitsuba 3 (`pip install '.[bench]'`, and its LLVM library in
DRJIT_LIBLLVM_PATH)."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

PICTURES = Path(__file__).with_suffix(".npz")
RUNS, SAMPLES = 16, 16384

FILM = """<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/>
<string name="component_format" value="float32"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="256"/></sampler>"""
FLOOR = """<shape type="rectangle" id="floor">
<transform name="to_world"><scale value="3"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".6 .5 .4"/></bsdf></shape>"""
POINT = """<emitter type="point"><point name="position" x="1" y="-2" z="3"/>
<rgb name="intensity" value="10 11 12"/></emitter>"""
LOOK = '<lookat origin="0, -4, 1.5" target="0, 0, .5" up="0, 0, 1"/>'


def camera(kind: str, settings: str, first: str = "") -> str:
    to_world = f'<transform name="to_world">{first}{LOOK}</transform>'
    return f'<sensor type="{kind}">{to_world}{settings}{FILM}</sensor>'


def scene(*parts: str, depth: int = 3) -> str:
    integrator = f'<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>'
    return f'<scene version="3.0.0">{integrator}{"".join(parts)}</scene>'


SCENES = {
    "shapes": scene(
        '<default name="grey" value=".5 .5 .6"/>',
        '<bsdf type="diffuse" id="blue"><rgb name="reflectance" value=".2 .5 .8"/></bsdf>',
        camera("perspective", '<float name="fov" value="40"/><string name="fov_axis" value="y"/>'),
        FLOOR,
        POINT,
        """<emitter type="directional"><vector name="direction" x=".3" y=".4" z="-1"/>
        <rgb name="irradiance" value=".5 .4 .1"/></emitter>""",
        """<shape type="sphere"><point name="center" x=".1" y="0" z=".2"/>
        <float name="radius" value=".2"/><transform name="to_world"><scale value="2"/>
        <rotate z="1" angle="30"/><translate x="-1.2" z=".1"/></transform><ref id="blue"/>
        </shape>""",
        """<shape type="cube"><transform name="to_world"><scale x="-.2" y=".5" z=".4"/>
        <rotate x="1" angle="40"/><rotate z="1" angle="20"/><translate x="-.2" z=".7"/></transform>
        <ref id="blue"/></shape>""",
        """<shape type="disk"><boolean name="flip_normals" value="true"/><transform name="to_world">
        <scale value=".5"/><rotate x="1" angle="-100"/><translate x=".6" y=".4" z="1"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="$grey"/></bsdf></shape>""",
        """<shape type="rectangle"><transform name="to_world"><scale x="-.4" y=".5"/>
        <rotate x="1" angle="60"/><translate x="1.3" z=".5"/></transform>
        <bsdf type="twosided"><ref id="blue"/></bsdf></shape>""",
    ),
    "lens": scene(
        camera(
            "thinlens",
            """<float name="fov" value="50"/><float name="aperture_radius" value=".15"/>
            <float name="focus_distance" value="3"/>""",
        ),
        FLOOR,
        """<emitter type="envmap"><string name="filename" value="sky.exr"/>
        <float name="scale" value=".5"/><transform name="to_world"><rotate x="1" angle="90"/>
        <rotate z="1" angle="35"/></transform></emitter>""",
        """<shape type="sphere"><point name="center" x=".6" y="-.5" z=".5"/>
        <float name="radius" value=".5"/><bsdf type="conductor">
        <rgb name="specular_reflectance" value=".9 .8 .7"/></bsdf></shape>""",
        """<shape type="ply"><string name="filename" value="corner.ply"/><transform name="to_world">
        <matrix value="1 .3 0 -1.2  0 .8 .2 0  0 0 1.3 .1  0 0 0 1"/></transform>
        <bsdf type="diffuse"/></shape>""",
    ),
    "lamps": scene(
        camera("orthographic", "", '<scale value="1.4"/>'),
        FLOOR,
        """<shape type="sphere"><point name="center" x="0" y="0" z=".6"/>
        <float name="radius" value=".5"/><bsdf type="dielectric"/></shape>""",
        """<shape type="sphere"><point name="center" x="1" y=".5" z="1.2"/>
        <float name="radius" value=".3"/><emitter type="area">
        <rgb name="radiance" value="5 6 7"/></emitter></shape>""",
        """<shape type="rectangle"><transform name="to_world"><scale value=".4"/>
        <rotate x="1" angle="100"/><translate x="-.9" y=".5" z=".8"/></transform>
        <emitter type="area"><rgb name="radiance" value="3 2 1"/></emitter></shape>""",
        """<emitter type="constant"><rgb name="radiance" value=".3 .4 .5"/></emitter>""",
        depth=6,
    ),
    "metals": scene(
        camera("perspective", '<string name="focal_length" value="35mm"/>'),
        FLOOR,
        """<emitter type="point"><point name="position" x="1" y="-2" z="3"/>
        <spectrum name="intensity" value="12"/></emitter>""",
        """<emitter type="directional"><vector name="direction" x="-.5" y=".4" z="-1"/>
        <spectrum name="irradiance" value="400:.2, 500:.4, 600:.3, 700:.1"/></emitter>""",
        """<shape type="sphere"><point name="center" x="-.6" y="0" z=".5"/>
        <float name="radius" value=".5"/><bsdf type="roughconductor">
        <string name="distribution" value="ggx"/><float name="alpha" value=".3"/>
        <rgb name="eta" value=".2 .9 1.2"/><rgb name="k" value="3 2.5 2"/></bsdf></shape>""",
        """<shape type="sphere"><point name="center" x=".6" y="0" z=".5"/>
        <float name="radius" value=".5"/><bsdf type="roughconductor">
        <float name="alpha" value=".2"/></bsdf></shape>""",
        """<shape type="cube"><transform name="to_world"><scale value=".3"/>
        <translate y="1" z="1.2"/></transform><bsdf type="diffuse">
        <spectrum name="reflectance" value="400:.1, 500:.3, 600:.7, 700:.9"/></bsdf></shape>""",
    ),
    "maps": scene(
        camera("perspective", '<float name="fov" value="45"/>'),
        POINT,
        """<shape type="rectangle"><transform name="to_world"><scale value="3"/></transform>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="colours.png"/>
        <transform name="to_uv"><scale x="3" y="2"/></transform></texture></bsdf></shape>""",
        """<shape type="sphere"><point name="center" x="-.8" y="0" z=".7"/>
        <float name="radius" value=".7"/><bsdf type="diffuse">
        <texture type="bitmap" name="reflectance"><string name="filename" value="colours.png"/>
        </texture></bsdf></shape>""",
        """<shape type="obj"><string name="filename" value="tile.obj"/><bsdf type="roughconductor">
        <texture type="bitmap" name="alpha"><string name="filename" value="rough.png"/>
        <string name="wrap_mode" value="clamp"/><boolean name="raw" value="true"/></texture>
        </bsdf></shape>""",
        depth=2,
    ),
}
TILE = """v .2 .6 .1
v 1.6 .6 .1
v 1.6 .9 1.3
v .2 .9 1.3
vt 0 0
vt 1 0
vt .9 .8
vt .1 .9
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""
CORNER = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


def sky() -> np.ndarray:
    """Return a smooth sky without symmetry, (64, 128, 3)."""
    down, along = np.meshgrid(
        np.pi * (np.arange(64) + 0.5) / 64, 2 * np.pi * (np.arange(128) + 0.5) / 128, indexing="ij"
    )
    bright = [np.exp(2 * np.cos(along - k) * np.sin(down) + np.cos(down)) for k in (1, 2, 4)]
    return np.stack(bright, axis=-1).astype(np.float32)


def textures() -> dict[str, np.ndarray]:
    """Return the codes of small pictures by name."""
    codes = np.random.default_rng(7).integers(40, 255, (4, 6, 3), np.uint8)
    rough = codes[:, :, 0] // 2 + 60
    return {"colours.png": codes, "rough.png": rough}


def write_scenes(folder: Path) -> None:
    """Write the scenes and their meshes. `sky.exr` and the textures are written by the tests that
    read them."""
    for name, text in SCENES.items():
        (folder / f"{name}.xml").write_text(text)
    (folder / "corner.ply").write_text(CORNER)
    (folder / "tile.obj").write_text(TILE)


def by_mitsuba() -> None:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    found = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_scenes(folder)
        mi.Bitmap(sky()).write(str(folder / "sky.exr"))
        for name, codes in textures().items():
            mi.Bitmap(codes).write(str(folder / name))
        for name in SCENES:
            loaded = mi.load_file(str(folder / f"{name}.xml"))
            runs = [
                np.array(mi.render(loaded, spp=SAMPLES, seed=seed))[..., :3] for seed in range(RUNS)
            ]
            found[name] = np.mean(runs, axis=0, dtype=float).astype(np.float32)
            error = np.std(runs, axis=0, ddof=1, dtype=float) / np.sqrt(RUNS)
            found[f"{name} error"] = error.astype(np.float32)
    np.savez_compressed(PICTURES, **found)


if __name__ == "__main__":
    by_mitsuba()
