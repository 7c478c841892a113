"""Files of scenes and meshes that several tests read, as text."""

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
