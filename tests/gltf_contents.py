"""A small glTF scene to read, change and damage."""

import base64

import numpy as np

LAMP = {"extensions": {"KHR_lights_punctual": {"light": 0}}}
CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], "<f4")
FACES = np.array([0, 1, 2, 0, 2, 3], "<u2")


def content(material=None, light=None, camera=None, **more):
    """Return a square in the plane z = 0, a camera 5 m above that looks down, and a lamp 2 m
    above."""
    blob = base64.b64encode(CORNERS.tobytes() + FACES.tobytes()).decode()
    made = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [
            {"name": "floor", "mesh": 0},
            {"camera": 0, "translation": [0, 0, 5]},
            {"translation": [0, 0, 2], **LAMP},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [material or matt(0.5, 0.4, 0.3)],
        "cameras": [camera or {"type": "perspective", "perspective": {"yfov": 0.1, "znear": 0.1}}],
        "extensions": {
            "KHR_lights_punctual": {"lights": [light or {"type": "point", "intensity": 683.0}]}
        },
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 60, "uri": f"data:application/gltf-buffer;base64,{blob}"}],
    }
    return made | more


def matt(*colour, **more):
    surface = {"baseColorFactor": [*colour, 1], "metallicFactor": 0}
    coat = {"KHR_materials_specular": {"specularFactor": 0}}
    return {"name": "paint", "pbrMetallicRoughness": surface, "extensions": coat} | more
