"""A scene: moving meshes with colours, cameras and places, drawn by pictures, films, pages and the viewer.

`items` holds the meshes and `scene_times` the frame times; `colouring` the colours of a mesh and `colours` those of
all, from `vertex_measures` and `palettes`; `camera` the view, `arrangement` the places of the meshes.
"""

from mixseq.scene.camera import Camera, View
from mixseq.scene.colouring import Colouring, colourings_of
from mixseq.scene.colours import SceneColours
from mixseq.scene.items import Scene, SceneItem

__all__ = ["Camera", "Colouring", "Scene", "SceneColours", "SceneItem", "View", "colourings_of"]
