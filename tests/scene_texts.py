"""Texts of scene files and meshes that several tests read."""

BALL = """
[camera]
kind = "pinhole"
position = [0, -4, 0.5]
target = [0, 0, 0]
resolution = [6, 8]
field_of_view = 50

[material.grey]
family = "lambert"
albedo = [0.2, 0.2, 0.2]

[[surface]]
shape = "sphere"
centre = [0, 0, 0]
radius = 1
material = "grey"

[[light]]
kind = "point"
position = [1, -2, 3]
intensity = [10, 10, 10]
"""
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""

PBRT = """
Scale -1 1 1 LookAt 0 -4 1.5  0 0 .5  0 0 1 # right-handed, as Mitsuba's
Camera "perspective" "float fov" 40 "float lensradius" .1 "float focaldistance" 3
Film "rgb" "integer xresolution" 16 "integer yresolution" 12
PixelFilter "box" Sampler "independent" "integer pixelsamples" 256
Integrator "volpath" "integer maxdepth" 3
WorldBegin
LightSource "point" "point3 from" [1 -2 3] "rgb I" [5 5.5 6] "float scale" 2
LightSource "distant" "point3 from" [0 0 0] "point3 to" [.3 .4 -1] "rgb L" [.5 .4 .1]
LightSource "infinite" "rgb L" [.3 .4 .5]
AttributeBegin
    Translate 1 .3 0 Rotate 50 1 0 0 Scale 2 2 2
    AttributeBegin Material "conductor" "float roughness" .09 "float eta" 1.5 "float k" 3
        Shape "sphere" "float radius" [ .5 ] AttributeEnd
    Material "diffuse" "spectrum reflectance" [400 .2 700 .6]
    Shape "disk" "float radius" .7 "float height" .2
AttributeEnd
AttributeBegin
    MakeNamedMaterial "glass" "string type" "dielectric" "float eta" 1.4
    Transform [1 0 0 0  .3 .8 0 0  0 .2 1.3 0  -1.2 0 .1 1]
    NamedMaterial "glass" Shape "plymesh" "string filename" "corner.ply"
AttributeEnd
AreaLightSource "diffuse" "rgb L" [5 6 7]
Shape "sphere" "float radius" .2
"""

PBRT_SURFACES = """
LookAt 0 -4 1.5  0 0 .5  0 0 1 Camera "orthographic" "float screenwindow" [-2 2 -1.5 1.5]
Film "rgb" "integer xresolution" 16 "integer yresolution" 12 PixelFilter "box" "float xradius" 1
WorldBegin
Texture "grey" "spectrum" "constant" "rgb value" [.6 .4 .2]
Texture "dark" "spectrum" "scale" "texture tex" "grey" "float scale" .5
LightSource "spot" "point3 from" [1 -1 3] "blackbody I" 3000 "float power" 40
ObjectBegin "floor" Material "diffuse" "texture reflectance" "dark"
    Shape "bilinearmesh" "point3 P" [-1 -1 0  1 -1 0  -1 1 0  1 1 0]
ObjectEnd
AttributeBegin Scale 3 3 3 ObjectInstance "floor" AttributeEnd
CoordinateSystem "here" ConcatTransform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1]
Material "coateddiffuse" "rgb reflectance" [.7 .3 .2] "float roughness" .04 "float eta" 1.4
Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "normal N" [0 0 1 0 0 1 0 0 1]
    "integer indices" [0 1 2] "point2 uv" [0 0 1 0 0 1]
CoordSysTransform "here" ReverseOrientation AreaLightSource "diffuse" "bool twosided" true
Shape "disk" "float height" 2
"""
